"""One stray return among many: labels that change farther than 3 m from it: `python -m bench.stray`.

A return is added to a scan, or one of it gets another remission. Nothing far from it should change. Beyond `SIGHT` no
convolution of the image network sees it: what changes there does so by the mean of a channel over the whole image.
"""

import sys
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import save, show
from bench.scans import load_frames
from runtime import MosRunner
from runtime.commands.handler import run_alone

NEAR, SIGHT = 3.0, 25.0  # m, degrees of azimuth
WITHIN = 5.0, 100.0  # m, of returns within reach

Stray = tuple[np.ndarray, np.ndarray]  # a scan (N or N + 1, 4), and its stray return (4,)


class Still(MosRunner):
    """A runner that scans leave as it was, while it is `still`."""

    still = False

    def _remember(self, *arguments: Any) -> int:
        return 0 if self.still else super()._remember(*arguments)


def added(nearest: float, farthest: float, scan: np.ndarray, rng: np.random.Generator) -> Stray:
    """A return more, the last, in a direction of another return."""
    distance = np.exp(rng.uniform(*np.log((nearest, farthest))))
    direction = scan[rng.integers(len(scan)), :3].astype(np.float64)
    xyz = distance * direction / np.linalg.norm(direction)
    stray = np.append(xyz, rng.uniform()).astype(np.float32)
    return np.vstack([scan, stray[None]]), stray


def repainted(remission: float | None, scan: np.ndarray, rng: np.random.Generator) -> Stray:
    """Another remission of one return; None: any."""
    found, at = scan.copy(), rng.integers(len(scan))
    found[at, 3] = rng.uniform() if remission is None else remission
    return found, found[at]


KINDS: dict[str, Callable[[np.ndarray, np.random.Generator], Stray]] = {
    "at 200 m": partial(added, 200, 200),
    "at 1e5 m": partial(added, 1e5, 1e5),
    "remission of 1e10": partial(repainted, 1e10),
    "another remission": partial(repainted, None),
    "within reach": partial(added, *WITHIN),
}


def far_changes(scan: np.ndarray, stray: np.ndarray, before: np.ndarray, after: np.ndarray) -> tuple[int, int]:
    """Labels of the returns of `scan` that changed far from the stray one, and of them out of its sight."""
    points = scan[before != after[: len(scan)], :3]
    turn = np.degrees(np.arctan2(points[:, 1], points[:, 0]) - np.arctan2(stray[1], stray[0]))
    far = np.linalg.norm(points - stray[:3], axis=1) > NEAR
    return int(far.sum()), int((far & (np.abs((turn + 180) % 360 - 180) > SIGHT)).sum())


def bench(
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    scans: Annotated[int, typer.Option(help="Of the drive")] = 28,
    with_strays: Annotated[int, typer.Option(help="The last of them, in which there are strays")] = 4,
    trials: Annotated[int, typer.Option(help="Strays of each kind in each of these")] = 25,
    seed: int = 0,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Labels that one stray return changes far from it, with each precision, with and without belief."""
    frames, rows = load_frames(sequence, scans), {}
    for precision, belief in product(("float32", "int8"), ("none", "online")):
        counts: dict[str, list[tuple[int, int]]] = {kind: [] for kind in KINDS}
        rng = np.random.default_rng(seed)
        with Still(bundle, threads=threads, precision=precision, belief=belief) as runner:
            for index, (scan, pose) in enumerate(frames):
                runner.still = True
                if index >= len(frames) - with_strays:
                    before = runner(scan, pose).moving
                    for kind, _ in product(KINDS, range(trials)):
                        other, stray = KINDS[kind](scan, rng)
                        counts[kind].append(far_changes(scan, stray, before, runner(other, pose).moving))
                runner.still = False
                runner(scan, pose)
        for kind, found in counts.items():
            far, unseen = np.array(found).T
            rows[f"{precision}, {'no belief' if belief == 'none' else 'belief'}: {kind}"] = {
                "strays": len(far),
                "labels that change far away, mean": round(float(far.mean()), 3),
                "most": int(far.max()),
                "out of sight, mean": round(float(unseen.mean()), 3),
                "strays that change none, %": round(100 * float((far == 0).mean()), 1),
            }
    show("simulated street" if sequence is None else str(sequence), rows)
    points = int(np.mean([len(scan) for scan, _ in frames]))
    setting = {"points": points, "scans": scans, "with_strays": with_strays, "seed": seed, "near_m": NEAR}
    save(out, threads, {**setting, "sight_degrees": SIGHT, "rows": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "stray"))
