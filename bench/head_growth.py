"""How the point head behaves as scans grow, and over many scans: time per multiply-add, resident memory."""

from pathlib import Path
from typing import Any

import numpy as np

from bench.head_scans import Refinement, Scan, make_head
from bench.plot import loglog
from bench.report import brief, interleaved, resident_mb, show, summary
from bench.scans import Frame, taking_part, there_and_back
from runtime.compute.workers import Workers
from runtime.head.voxels import voxelise
from runtime.recordings.poses import relative_pose

SIZES = (1_000, 10_000, 100_000, 300_000, 500_000)  # voxels
SETTLED = 50  # scans after which memory must not grow
WHOLE_EVERY = 10  # scans after that: one is refined whole, the others near candidates


def merged(frames: list[Frame]) -> np.ndarray:
    """All points (N, 4) of some scans in the frame of the first."""
    clouds = []
    for scan, pose in frames:
        points, relative = taking_part(scan), relative_pose(frames[0][1], pose)
        moved = points[:, :3] @ relative[:3, :3].T + relative[:3, 3]
        clouds.append(np.concatenate((moved, points[:, 3:]), axis=1).astype(np.float32))
    return np.concatenate(clouds)


def with_voxels(points: np.ndarray, count: int) -> np.ndarray:
    """As many of the first points (N, 4) as fill `count` voxels, or all."""
    first = np.sort(voxelise(points[:, :3], 0.05, Workers(1)).first)
    return points if count >= len(first) else points[: first[count]]


def sizes(frames: list[Frame], threads: int, rounds: int, plot: Path | None) -> dict[str, Any]:
    """Lite head on clouds of more and more voxels: the middle of a scan, a scan, merged scans."""
    engine, rows = make_head("lite", threads), {}
    cloud = merged(frames)
    one = cloud[: len(frames[0][0])]
    middle = one[np.argsort(np.abs(one[:, :2]).max(axis=1), kind="stable")]
    for size in SIZES:
        task = Refinement(engine, Scan(with_voxels(cloud if size >= 100_000 else middle, size)).args)
        seconds = interleaved({"": task}, max(rounds, 20) if size <= 10_000 else rounds)[""]
        rows[str(engine.voxels)] = {
            **summary(seconds),
            "ps per multiply-add": 1e12 * float(np.median(seconds)) / engine.multiply_adds,
            "G multiply-adds": engine.multiply_adds / 1e9,
            "buffers MB": engine.workspace / 1e6,
        }
    show("cost against size (lite), by number of voxels, ms", brief(rows))
    if plot is not None:
        points = [(int(voxels), row["median"]) for voxels, row in rows.items()]
        loglog(plot, points, "lite point head, whole scans", "voxels of 5 cm", "ms per scan")
    return rows


def memory(scans: list[Scan], threads: int, count: int) -> dict[str, Any]:
    """Resident memory (MB) of `count` scans, a sequence forwards and backwards: the first 50 whole, then as in use."""
    engine = make_head("lite", threads)
    order = there_and_back(scans)
    settled = min(SETTLED, count)
    row: dict[str, Any] = {}
    for i in range(count):
        scan = order[i % len(order)]
        whole = i < settled or i % WHOLE_EVERY == 0
        engine.refine(*scan.args, None if whole else scan.near(i))
        if i + 1 == settled:
            row[f"MB after scan {settled}"] = before = resident_mb()
    row |= {f"MB after scan {count}": resident_mb(), "growth": resident_mb() - before, "scans": count}
    show("resident memory (lite)", {"": row})
    return row
