"""One bundle on every sensor: `python -m bench.sensors --kitti ROOT`.

Simulated test streets of each profile; places in which nothing moves, where a network may see movers all the same; and
a real drive with some of its lasers left out, whose sensor is found from its points.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bench.accuracy import STREETS, Drive, Scan, percent, real, score, scores, simulated, with_runner
from bench.report import save, show
from runtime import MosRunner
from runtime.classes import MOVING, STATIC
from runtime.commands.handler import run_alone
from runtime.sensors.registry import SENSORS

STILL = 19_000_000  # seeds of places in which nothing moves


def thinned(drive: Drive, step: int) -> Drive:
    """Every `step`-th laser of a drive of KITTI, whose files hold one laser after the other, azimuth from 0 up."""

    def some() -> Iterator[Scan]:
        for scan in drive():
            azimuth = np.degrees(np.arctan2(scan.points[:, 1], scan.points[:, 0])) % 360
            laser = np.cumsum(np.concatenate([[0], np.diff(azimuth) < -180]))
            kept = laser % step == 0
            yield scan._replace(points=scan.points[kept], classes=scan.classes[kept])

    return some


def ahead(drive: Drive, degrees: float) -> Drive:
    """What a sensor without a turn sees of a drive: the points so many degrees about its front."""

    def some() -> Iterator[Scan]:
        for scan in drive():
            azimuth = np.degrees(np.arctan2(scan.points[:, 1], scan.points[:, 0]))
            kept = np.abs(azimuth) < degrees / 2
            yield scan._replace(points=scan.points[kept], classes=scan.classes[kept])

    return some


def still(count: int) -> dict[str, tuple[str, list[Drive]]]:
    """Places without a mover: the sensor, and drives of each kind."""
    every = count // 2
    return {
        "rooms, standing": (
            "rs16",
            simulated("rs16", STILL, count, 2, version=2, street="room", ego="standing", movers=0.0),
        ),
        "fog": ("hdl32e", simulated("hdl32e", STILL + 1000, every, 2, weather="fog", movers=0.0)),
        "rain": ("hdl32e", simulated("hdl32e", STILL + 2000, every, 2, weather="rain", movers=0.0)),
    }


def bench(
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    kitti: Annotated[Path | None, typer.Option(help="Root of KITTI sequence 90, which has labels")] = None,
    streets: Annotated[int, typer.Option(help="Simulated test streets of each sensor")] = 12,
    frames: Annotated[int, typer.Option(help="Scored scans of each")] = 4,
    places: Annotated[int, typer.Option(help="Simulated places of each kind in which nothing moves")] = 20,
    sensors: Annotated[str, typer.Option(help="Names, as hdl64e,vlp16", show_default="all")] = "",
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Moving IoU, precision and recall (%) by sensor; false alarms where nothing moves."""
    rows: dict[str, dict[str, float | None]] = {}
    for name in sensors.split(",") if sensors else SENSORS:
        with MosRunner(bundle, threads=threads, sensor=name) as runner:
            drives = simulated(name, STREETS, streets, frames)
            rows[name] = scores(score(drives, {"": with_runner(runner)})[""])
    alarms: dict[str, dict[str, float | None]] = {}
    for title, (name, drives) in still(places).items():
        with MosRunner(bundle, threads=threads, sensor=name) as runner:
            matrix = score(drives, {"": with_runner(runner)})[""].matrix
            alarms[title] = {"false alarms": percent(matrix[STATIC, MOVING] / max(1, matrix[STATIC].sum()), 4)}
    found: dict[str, dict[str, float | None]] = {}
    drives = [ahead(drive, 120) for drive in simulated("os1-64", STREETS, streets, frames)]
    with MosRunner(bundle, threads=threads) as runner:
        found["simulated os1-64, 120 degrees of its turn"] = scores(score(drives, {"": with_runner(runner)})[""])
    if kitti is not None:
        drive = real(kitti / "sequences/90")
        for step in (1, 2, 4):
            with MosRunner(bundle, threads=threads) as runner:
                found[f"real 90, {64 // step} lasers"] = scores(
                    score([thinned(drive, step)], {"": with_runner(runner)})[""]
                )
    show("moving class of simulated streets, %", rows)
    show("nothing moves, % of the points", alarms)
    show("sensor found from the points, %", found)
    setting = {"streets": streets, "frames": frames, "places": places}
    save(out, threads, {**setting, "percent": rows, "still": alarms, "found": found})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "sensors"))
