"""How much a core labels, how much side by side, and what a fleet would: `python -m bench.fleet`."""

import os
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import save, show
from runtime.commands.handler import need_extra, run_alone
from runtime.fleet.events import Done
from runtime.fleet.here import label_here
from runtime.fleet.on_ray import label_on_ray
from runtime.fleet.plan import Way
from runtime.fleet.processes import label_in_processes
from runtime.fleet.wanted import Wanted
from runtime.fleet.work import settle
from runtime.recordings.labels import LABEL_BYTES
from runtime.recordings.recording import Options
from runtime.recordings.searching import search_recordings
from runtime.settings import RunnerSettings

# What is taken for granted in the arithmetic
NODES, CORES = 100, 16  # machines, and processors of each
DRIVES = 430_000  # scans: 12 hours at 10 Hz
DISK, NETWORK = 2e9, 1.25e9  # bytes a second of a machine: an NVMe disk, 10 Gbit/s
GETS, PUTS = 5500, 3500  # requests a second below one prefix, as S3's documentation has them


def bench(
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else simulated streets")] = None,
    scans: Annotated[int, typer.Option(help="Of each recording")] = 100,
    rounds: Annotated[int, typer.Option(help="Of each way, in turn")] = 3,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Scans a second and a core, time beside that of plain `mos run`, and what 100 machines would take."""
    need_extra("fleet", "ray")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path.cwd()), os.environ.get("PYTHONPATH", "")])
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        drives = _drives(root, sequence, scans)
        ms, points = _beside_plain(root, drives[:1], scans, rounds)
        plain = float(np.median(ms["plain mos run"]))
        ways = {
            name: {"ms a scan": float(np.median(one)), "beside plain": float(np.median(one)) / plain}
            for name, one in ms.items()
        }
        show("one worker, one thread", ways)
        speed = _speeds(root, drives, scans)
        show("scans a second", speed)
    read, written = 16 * points, LABEL_BYTES * points  # x, y, z, remission
    fleet = _arithmetic(max(row["a core"] for row in speed.values()), read, written)
    show(f"arithmetic, not measured: {NODES} machines of {CORES} processors, {DRIVES:,} scans", fleet)
    results = {"scans": scans, "points_a_scan": points, "ways": ways, "all_ms": ms, "speed": speed, "arithmetic": fleet}
    save(out, 2, results)


def _drives(root: Path, sequence: Path | None, scans: int) -> list[Path]:
    """Two recordings."""
    if sequence is None:
        from mos_model.simulator.write import write_dataset

        write_dataset(root / "logs", 2, scans, 7)
        return search_recordings([root / "logs"])
    for name in ("00", "01"):
        (root / "logs" / name).parent.mkdir(exist_ok=True)
        (root / "logs" / name).symlink_to(sequence.absolute())
    return [root / "logs" / name for name in ("00", "01")]


def _label(way: Way, out: Path, drives: list[Path], scans: int, threads: int) -> list[Done]:
    """What became of each recording; its seconds are without those in which its process began."""
    work = settle(None, RunnerSettings(threads=threads), Options(limit=scans), out, True, Wanted())
    heard: list[Any] = []
    way(work, drives, hear=heard.append)
    done = [one for one in heard if isinstance(one, Done)]
    assert all(one.scans == scans and not one.error for one in done), done
    return done


def _beside_plain(root: Path, drives: list[Path], scans: int, rounds: int) -> tuple[dict[str, list[float]], float]:
    """Milliseconds a scan of each way, in turn, and points of a scan."""
    ways: dict[str, Callable[..., None]] = {
        "plain mos run": label_here,
        "--jobs 1": partial(label_in_processes, jobs=1),
        "--on ray, one worker": partial(label_on_ray, address=None),
    }
    found: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(rounds):
        for name, way in ways.items():
            (done,) = _label(way, root / "out", drives, scans, 1)
            found[name].append(1e3 * done.seconds / scans)
    return found, done.points / scans


def _speeds(root: Path, drives: list[Path], scans: int) -> dict[str, dict[str, Any]]:
    found = {}
    for workers in (1, 2):
        for threads in (1, 2):
            way = partial(label_in_processes, jobs=workers)
            done = _label(way, root / "out", drives[:workers], scans, threads * workers)
            speed = sum(scans / one.seconds for one in done)
            cores = min(os.cpu_count() or 1, threads * workers)
            found[f"{workers} workers of {threads} threads"] = {
                "scans/s": speed,
                "cores": cores,
                "a core": speed / cores,
            }
    return found


def _arithmetic(core: float, read: float, written: float) -> dict[str, dict[str, Any]]:
    """core: scans a second of one; bytes read and written of each. What each limit would let through."""
    fleet = core * NODES * CORES
    limits = {
        "processors": fleet,
        "disks of the machines": NODES * DISK / (read + written),
        "network of the machines": NODES * NETWORK / (read + written),
        "a store, one prefix: objects read": float(GETS),
        "a store, one prefix: objects written": float(PUTS),
    }
    return {
        name: {"scans/s": one, "minutes": DRIVES / one / 60, "share used": fleet / one} for name, one in limits.items()
    }


if __name__ == "__main__":
    sys.exit(run_alone(bench, "fleet"))
