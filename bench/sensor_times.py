"""What a scan of each sensor costs: `python -m bench.sensor_times`, on a machine that does nothing else.

The default runner on one simulated drive of each profile, beside the first of them.
"""

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from bench.accuracy import STREETS
from bench.report import save, show
from mos_model.simulator import simulate
from runtime import MosRunner
from runtime.bundle.residual import HISTORY
from runtime.commands.handler import run_alone
from runtime.sensors.registry import DEFAULT_SENSOR, SENSORS


def times(runner: MosRunner, scans: list, rounds: int) -> np.ndarray:
    """ms of the calls with a full history."""
    found = []
    for _ in range(rounds):
        runner.reset()
        calls = [runner(scan.points, scan.pose).timing["total"] for scan in scans]
        found += calls[HISTORY:]
    return 1e3 * np.array(found)


def bench(
    bundle: Annotated[Path | None, typer.Option(help="Bundle", show_default="the default one")] = None,
    sensors: Annotated[str, typer.Option(help="Names, as hdl64e,vlp16", show_default="all")] = "",
    frames: Annotated[int, typer.Option(help="Scans of the drive that count")] = 30,
    rounds: int = 3,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Median and 95th percentile of the time of a scan (ms), points of a scan, and the median over that of HDL-64E."""
    rows: dict[str, dict[str, float | None]] = {}
    median: dict[str, float] = {}
    for name in dict.fromkeys([DEFAULT_SENSOR, *(sensors.split(",") if sensors else SENSORS)]):
        scans = simulate(STREETS, HISTORY + frames, name)
        with MosRunner(bundle, threads=threads, sensor=name) as runner:
            found = times(runner, scans, rounds)
        median[name] = float(np.median(found))
        rows[name] = {
            "points": float(np.mean([len(scan.points) for scan in scans]).round()),
            "ms": round(median[name], 1),
            "p95": round(float(np.quantile(found, 0.95)), 1),
            "share": round(median[name] / median[DEFAULT_SENSOR], 2),
        }
    show("ms a scan", rows)
    save(out, threads, {"frames": frames, "rounds": rounds, "ms": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "sensor_times"))
