"""Accuracy of bundles through MosRunner, beside what needs no training and another tool: `python -m bench.accuracy`.

Every bundle that ships with each of its post-processings, and with belief; the threshold on residuals; and, where they
are installed, dynamic-object-removal and DUFOMap. All of them see the same scans.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import typer

from bench.peers import Peer, peers, versions
from bench.report import ROOT, save, show
from mos_model.simulator import simulate
from runtime import MosRunner
from runtime.bundle.loading import Bundle, load_bundle
from runtime.bundle.manifest import SensorEntry
from runtime.bundle.residual import HISTORY, Residual
from runtime.classes import MOVING, STATIC, to_classes
from runtime.commands.handler import run_alone
from runtime.compute.workers import Workers
from runtime.evaluation.confusion import Confusion
from runtime.image.history import History
from runtime.image.inputs import InputBuilder
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording

STREETS = 12_000_000  # seeds of the simulated test streets: neither training, validation nor calibration has them
QUIET = 13_000_000  # seeds of streets without a mover


class Scan(NamedTuple):
    """A scan with what is known of it."""

    points: np.ndarray  # (N, 4) f32
    pose: np.ndarray  # (4, 4)
    classes: np.ndarray  # (N,) 0 unlabelled, 1 static, 2 moving
    scored: bool


Drive = Callable[[], Iterator[Scan]]
System = Callable[[list[Scan]], Iterator[np.ndarray]]  # moving (N,) of each scan of a drive, in order


def simulated(sensor: str, first: int, count: int, frames: int, **settings: object) -> list[Drive]:
    """Drives of HISTORY + `frames` scans of a sensor, of which the last are scored."""

    def drive(seed: int) -> Iterator[Scan]:
        for index, frame in enumerate(simulate(seed, HISTORY + frames, sensor, **settings)):
            yield Scan(frame.points, frame.pose, to_classes(frame.labels), index >= HISTORY)

    return [lambda seed=first + i: drive(seed) for i in range(count)]


def real(folder: Path, first: int = HISTORY, limit: int | None = None) -> Drive:
    """A KITTI sequence, from frame `first` on scored. Without labels every point counts as static."""

    def drive() -> Iterator[Scan]:
        recording = open_recording(folder, Options(limit=limit))
        for index, scan in enumerate(recording.scans()):
            labels = recording.labels(index)
            classes = np.full(len(scan.data), STATIC, np.uint8) if labels is None else to_classes(labels)
            yield Scan(scan.data, scan.known_pose(), classes, index >= first)

    return drive


def score(drives: list[Drive], systems: Mapping[str, System]) -> dict[str, Confusion]:
    """One confusion matrix over all scored scans for each system."""
    found = {name: Confusion() for name in systems}
    for drive in drives:
        scans = list(drive())
        for name, system in systems.items():
            for scan, moving in zip(scans, system(scans), strict=True):
                if scan.scored:
                    found[name].add(scan.classes, np.where(moving, MOVING, STATIC))
    return found


def with_runner(runner: MosRunner, delay: bool = False) -> System:
    """A bundle, with or without a delay. Scans that are not scored are only remembered, where no label waits for them:
    that leaves the same history."""

    def label(scans: list[Scan]) -> Iterator[np.ndarray]:
        runner.reset()
        for scan in scans:
            if not (scan.scored or delay):
                runner.remember(scan.points, scan.pose)
                yield np.zeros(len(scan.points), bool)
            elif (result := runner(scan.points, scan.pose)) is not None:
                yield result.moving
        if delay:
            yield from (result.moving for result in runner.flush())

    return label


def residual_threshold(sensor: SensorEntry) -> System:
    """Untrained: the median over the 8 past scans of (r_past - r_now) / r_now is above 0.1."""

    def label(scans: list[Scan]) -> Iterator[np.ndarray]:
        builder = InputBuilder(sensor.range_image, Residual(kind="signed"), Workers(2), sensor.reach)
        history = History()
        for scan in scans:
            entered = builder.enter(scan.points)
            made = builder.build(entered, history.past(scan.pose))
            history.add(entered, scan.pose, None)
            changed = (np.median(made.image[5:], axis=0) > 0.1).reshape(-1)
            yield changed[np.maximum(made.pixel, 0)] & entered.takes_part

    return label


def with_peer(peer: Peer) -> System:
    """Another tool, which sees every scan."""
    return lambda scans: peer([scan.points for scan in scans], [scan.pose for scan in scans])


def shipped() -> list[Path]:
    """Every bundle under models/."""
    return sorted(manifest.parent for manifest in (ROOT / "models").glob("*/manifest.json"))


def common_sensor(bundles: list[Bundle]) -> SensorEntry:
    """The sensor of all of them, whose streets they can be measured on."""
    sensors = {bundle.manifest.sensor.name: bundle.manifest.sensor for bundle in bundles}
    if len(sensors) != 1:
        raise typer.BadParameter(f"these bundles are for the sensors {', '.join(sensors)}: measure each with its own")
    (sensor,) = sensors.values()
    return sensor


def systems_of(bundles: list[Bundle], threads: int, precision: str) -> dict[str, System]:
    """The threshold, and every bundle with each post-processing that it has, and with belief if it has numbers."""
    systems = {"residual threshold, untrained": residual_threshold(common_sensor(bundles))}

    def runner(bundle: Bundle, kind: str, **settings: object) -> MosRunner:
        return MosRunner(bundle.path, threads=threads, precision=precision, postprocess=kind, **settings)

    for bundle in bundles:
        name, kinds = bundle.path.name, bundle.manifest.postprocesses
        best = "head" if "head" in kinds else "none"
        for kind in kinds:
            systems[f"{name}, {kind}"] = with_runner(runner(bundle, kind, belief="none"))
        if bundle.manifest.tuned.belief is not None:
            systems[f"{name}, {best}, belief"] = with_runner(runner(bundle, best))
            systems[f"{name}, {best}, 10 scans later"] = with_runner(runner(bundle, best, delay=10), delay=True)
    return systems


def bench(
    bundles: Annotated[list[Path] | None, typer.Argument(help="Bundles", show_default="all under models/")] = None,
    kitti: Annotated[Path | None, typer.Option(help="Root of KITTI sequences 90 (labelled) and 00")] = None,
    streets: Annotated[int, typer.Option(help="Simulated test streets")] = 60,
    frames: Annotated[int, typer.Option(help="Scored scans of each")] = 2,
    quiet: Annotated[int, typer.Option(help="Simulated scans without a mover")] = 200,
    precision: Annotated[str, typer.Option(help="auto, float32 or int8, of the image networks")] = "auto",
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Moving IoU, precision and recall (%) of every bundle and post-processing; false alarms where nothing moves."""
    loaded = [load_bundle(path) for path in bundles or shipped()]
    sensor = common_sensor(loaded).name
    sets = {"simulated": simulated(sensor, STREETS, streets, frames)}
    alarms = {"quiet streets": simulated(sensor, QUIET, -(-quiet // frames), frames, movers=0.0)}
    if kitti is not None:
        sets["real 90"] = [real(kitti / "sequences/90")]
        alarms["real 00, frames 8-10"] = [real(kitti / "sequences/00", limit=11)]
    others, left_out = peers(threads)
    systems = systems_of(loaded, threads, precision)
    systems |= {name: with_peer(peer) for name, peer in others.items()}
    rows: dict[str, dict[str, float | None]] = {name: {} for name in systems}
    for title, drives in sets.items():
        for name, found in score(drives, systems).items():
            rows[name] |= {f"{title} {measure}": value for measure, value in scores(found).items()}
    for title, drives in alarms.items():
        for name, found in score(drives, systems).items():
            matrix = found.matrix
            rows[name][f"{title} false alarms"] = percent(matrix[STATIC, MOVING] / max(1, matrix[STATIC].sum()), 4)
    show("moving class, %", rows)
    for name, reason in left_out.items():
        typer.echo(f"left out: {name}: {reason}")
    setting = {"sensor": sensor, "streets": streets, "frames": frames, "quiet": quiet, "precision": precision}
    save(out, threads, {**setting, "percent": rows, "left_out": left_out, "peers": versions()})


def scores(found: Confusion) -> dict[str, float | None]:
    """IoU, precision and recall of the moving class in %."""
    return {measure: percent(getattr(found, measure), 2) for measure in ("iou", "precision", "recall")}


def percent(share: float, digits: int) -> float | None:
    """A share in %; None where it is undefined (NaN)."""
    return None if np.isnan(share) else round(100 * float(share), digits)


if __name__ == "__main__":
    sys.exit(run_alone(bench, "accuracy"))
