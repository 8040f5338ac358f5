"""Does it stay as fast and as small: CPU time and memory over thousands of scans: `python -m bench.steadiness`."""

import sys
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import resident_mb, save, show, summary
from bench.scans import load_frames, there_and_back
from runtime import MosRunner
from runtime.commands.handler import run_alone

SETTLED = 50  # scans, after which memory must not grow


def bench(
    bundle: Annotated[Path | None, typer.Argument(help="Bundle", show_default="the default one")] = None,
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    postprocess: Annotated[str | None, typer.Option(help="none, knn or head", show_default="the bundle's")] = None,
    threads: int = 2,
    scans: Annotated[int, typer.Option(help="The sequence forwards and backwards")] = 2000,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Percentiles of CPU and wall time a scan, and resident memory after 50 scans and after the last."""
    frames = load_frames(sequence, 60)
    order = there_and_back(frames)
    runner = MosRunner(bundle, threads=threads, postprocess=postprocess)
    wall, cpu, memory = [], [], 0.0
    for i in range(scans):
        started, used = time.perf_counter(), time.process_time()
        runner(*order[i % len(order)])
        cpu.append(time.process_time() - used)
        wall.append(time.perf_counter() - started)
        if i + 1 == SETTLED:
            memory = resident_mb()
    rows: dict[str, dict[str, Any]] = {"CPU time, ms": summary(cpu[SETTLED:]), "wall time, ms": summary(wall[SETTLED:])}
    for row in rows.values():
        row["p99 / median"] = round(row["p99"] / row["median"], 3)
    show(f"{runner.bundle.manifest.name}, {runner.postprocess}, {threads} threads, {scans} scans", rows)
    growth = resident_mb() - memory
    typer.echo(f"resident memory: {memory:.1f} MB after {SETTLED} scans, {growth:+.1f} MB after {scans}")
    points = int(np.mean([len(scan) for scan, _ in frames]))
    save(out, threads, {"points": points, "scans": scans, "times": rows, "resident_mb": memory, "growth_mb": growth})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "steadiness"))
