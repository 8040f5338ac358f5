"""From which share of looks on a place was free: what `mos clean` leaves of simulated drives: `python -m bench.free_share`.

Chosen is the share with the fewest points on the wrong side, static ones that go or dynamic ones that stay. Real drives
have no part in it.
"""

import sys
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import save, show
from mos_model.simulator import simulate
from mos_model.tuning.thresholds import LIGHT_TRAFFIC
from runtime import MosRunner
from runtime.classes import MOVING, STATIC, to_classes
from runtime.cleaning.looks import Looks
from runtime.cleaning.votes import VOXEL
from runtime.cleaning.voxel_votes import VoxelVotes
from runtime.commands.clean import DELAY
from runtime.commands.handler import run_alone
from runtime.evaluation.confusion import Confusion
from runtime.recordings.poses import relative_pose
from runtime.recordings.scans import moved

DRIVES = 17_500_000  # seeds from here on
SHARES = (0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
SENSORS = ("hdl64e", "pandar64", "hdl64e", "os1-64", "hdl64e", "vlp16")
SENSORS += ("hdl64e", "pandar64", "hdl32e", "hdl64e", "vls128", "os1-128")  # in turn


def count_drive(number: int, scans: int, bundle: Path | None, threads: int, counts: dict[float, Confusion]) -> None:
    """Count the points of a simulated drive by what is left out at each share of looks.

    Every third is of the wide variety that a network of several sensors learnt from, every fourth has light traffic.
    """
    sensor = SENSORS[number % len(SENSORS)]
    settings: dict[str, Any] = {"version": 2 if number % 3 == 2 else 1}
    if number % 4 == 1:
        settings["movers"] = LIGHT_TRAFFIC
    drive = list(simulate(DRIVES + number, scans, sensor=sensor, **settings))
    with MosRunner(bundle, threads=threads, delay=DELAY, sensor=sensor) as runner:
        found = [*(runner(scan.points, scan.pose) for scan in drive), *runner.flush()]
    labels = [result.moving for result in found if result is not None]
    votes, first = VoxelVotes(VOXEL), drive[0].pose
    placed = [moved(scan.points, relative_pose(first, scan.pose)).astype(np.float64) for scan in drive]
    for points, scan, moving in zip(placed, drive, labels, strict=True):
        votes.add(points, scan.points[:, 3], moving)
    looks = Looks(votes.moving())
    for scan in drive:
        looks.add(scan.points, relative_pose(scan.pose, first))
    for share in sorted(counts):  # what is free at a share is free at all below it
        votes.take_back(looks.voxels.rows[~looks.free(share)])
        for points, scan in zip(placed, drive, strict=True):
            counts[share].add(to_classes(scan.labels), np.where(votes.moves(points), MOVING, STATIC))


def bench(
    bundle: Annotated[Path | None, typer.Argument(help="Bundle", show_default="the default one")] = None,
    drives: Annotated[int, typer.Option(help="Simulated, of several sensors")] = 16,
    scans: Annotated[int, typer.Option(help="Of each drive")] = 50,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Static points that go and dynamic ones that stay, at several shares of looks through what moves."""
    counts = {share: Confusion() for share in SHARES}
    for number in range(drives):
        count_drive(number, scans, bundle, threads, counts)
    rows = {}
    for share, confusion in counts.items():
        static, dynamic = confusion.matrix[STATIC], confusion.matrix[MOVING]
        accuracy = {
            "static (SA), %": 100 * static[STATIC] / static.sum(),
            "dynamic (DA), %": 100 * dynamic[MOVING] / dynamic.sum(),
        }
        rows[str(share)] = {**accuracy, "points on the wrong side": int(static[MOVING] + dynamic[STATIC])}
    show("simulated drives, by share of looks", rows)
    save(out, threads, {"drives": drives, "scans": scans, "first seed": DRIVES, "shares": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "free_share"))
