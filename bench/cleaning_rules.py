"""What rays must have gone through, for `mos clean` to leave it out: `python -m bench.cleaning_rules`.

Of each rule, what it leaves of simulated drives. Chosen is a share of looks at which few points are on the wrong side,
static ones that go or dynamic ones that stay, which is flat from 30 to 40 %; and an area that hardly costs movers, also
those of sensors of few beams. Real drives have no part in it.
"""

import sys
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import save, show
from mos_model.simulator import simulate
from mos_model.tuning.thresholds import LIGHT_TRAFFIC
from runtime import MosRunner
from runtime.classes import MOVING, STATIC, to_classes
from runtime.cleaning.looks import AREA, FREE, Looks
from runtime.cleaning.votes import VOXEL
from runtime.cleaning.voxel_votes import VoxelVotes
from runtime.commands.clean import DELAY
from runtime.commands.handler import run_alone
from runtime.evaluation.confusion import Confusion
from runtime.recordings.poses import relative_pose
from runtime.recordings.scans import moved
from runtime.sensors import hesai, ouster, velodyne

DRIVES = 17_500_000  # seeds from here on
SHARES, AREAS = (0.2, 0.3, 0.35, 0.4, 0.5), (0.05, 0.1, 0.15, 0.2, 0.5)
RULES = {f"{100 * share:g} % of the looks": (share, 0.0) for share in SHARES}
RULES |= {f"{100 * FREE:g} %, {area:g} m^2": (FREE, area) for area in AREAS}
HDL64E, HDL32E, VLS128, PANDAR64 = velodyne.HDL64E, velodyne.HDL32E, velodyne.VLS128, hesai.PANDAR64
OS1_64, OS1_128 = ouster.OS1[1:3]
_OFTEN = (HDL64E, PANDAR64, HDL64E)
SENSORS = (*_OFTEN, OS1_64, HDL64E, velodyne.VLP16, *_OFTEN[:2], HDL32E, HDL64E, VLS128, OS1_128)  # in turn


def count_drive(number: int, scans: int, bundle: Path | None, threads: int, counts: dict[str, Confusion]) -> None:
    """Count the points of a simulated drive by what is left out by each rule.

    Every third is of the wide variety that a network of several sensors learnt from, every fourth has light traffic.
    """
    sensor = SENSORS[number % len(SENSORS)].name
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
    for name, rule in RULES.items():
        left = deepcopy(votes)
        left.take_back(looks.voxels.rows[~looks.free(*rule)])
        for points, scan in zip(placed, drive, strict=True):
            counts[name].add(to_classes(scan.labels), np.where(left.moves(points), MOVING, STATIC))


def bench(
    bundle: Annotated[Path | None, typer.Argument(help="Bundle", show_default="the default one")] = None,
    drives: Annotated[int, typer.Option(help="Simulated, of several sensors")] = 16,
    scans: Annotated[int, typer.Option(help="Of each drive")] = 50,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Static points that stay and dynamic ones that go, by what rays must have gone through."""
    counts = {name: Confusion() for name in RULES}
    for number in range(drives):
        count_drive(number, scans, bundle, threads, counts)
    rows = {}
    for name, confusion in counts.items():
        static, dynamic = confusion.matrix[STATIC], confusion.matrix[MOVING]
        accuracy = {
            "static (SA), %": 100 * static[STATIC] / static.sum(),
            "dynamic (DA), %": 100 * dynamic[MOVING] / dynamic.sum(),
        }
        rows[name] = {**accuracy, "points on the wrong side": int(static[MOVING] + dynamic[STATIC])}
    show(f"{drives} simulated drives; chosen: {100 * FREE:g} %, {AREA:g} m^2", rows)
    save(out, threads, {"drives": drives, "scans": scans, "first seed": DRIVES, "rules": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "cleaning_rules"))
