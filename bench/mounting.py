"""What another mounting of the sensor costs: `python -m bench.mounting --kitti ROOT`.

The points of a real drive as a sensor elsewhere would tell them: turned and moved, with poses that follow. What it
would see from there, and what would be hidden, is not in the recording.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bench.accuracy import Drive, Scan, real, score, scores, with_runner
from bench.report import save, show
from bench.scans import entered
from runtime import MosRunner
from runtime.commands.handler import run_alone
from runtime.recordings.poses import relative_pose


def turned(axis: int, degrees: float) -> np.ndarray:
    """T_old_new (4, 4) of a sensor that is turned about x, y or z of the old one."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    angle, there = np.radians(degrees), np.eye(4)
    there[[a, a, b, b], [a, b, a, b]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return there


def lifted(height: float) -> np.ndarray:
    """T_old_new (4, 4) of a sensor that is `height` m above the old one."""
    there = np.eye(4)
    there[2, 3] = height
    return there


MOUNTINGS = {
    "as recorded": np.eye(4),
    "looking 2 degrees down": turned(1, 2),
    "looking 5 degrees down": turned(1, 5),
    "looking 5 degrees up": turned(1, -5),
    "leaning 5 degrees": turned(0, 5),
    "0.3 m lower": lifted(-0.3),
    "0.7 m lower": lifted(-0.7),
    "0.7 m higher": lifted(0.7),
    "looking backwards": turned(2, 180),
}


def mounted(drive: Drive, there: np.ndarray) -> Drive:
    """The same drive with the sensor at T_old_new."""
    back = relative_pose(there, np.eye(4))

    def moved() -> Iterator[Scan]:
        for scan in drive():
            points = scan.points.copy()
            returned = entered(points).takes_part
            points[returned, :3] = points[returned, :3] @ back[:3, :3].T + back[:3, 3]
            yield scan._replace(points=points, pose=scan.pose @ there)

    return moved


def bench(
    kitti: Annotated[Path, typer.Option(help="Root of KITTI sequence 90, which has labels")],
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Moving IoU, precision and recall (%) of real 90 for each mounting."""
    runner = MosRunner(bundle, threads=threads)
    drive = real(kitti / "sequences/90")
    rows = {
        name: scores(score([mounted(drive, there)], {"": with_runner(runner)})[""]) for name, there in MOUNTINGS.items()
    }
    show("moving class of real 90, %", rows)
    save(out, threads, {"bundle": runner.bundle.manifest.name, "percent": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "mounting"))
