"""Time from points and pose to labels, stage by stage, through MosRunner: `python -m bench.latency`."""

import resource
from pathlib import Path
from typing import Annotated

import typer

from bench.report import save, show, summary
from bench.scans import load_frames
from runtime import MosRunner
from runtime.sensor import HISTORY


def bench(
    bundles: Annotated[list[Path] | None, typer.Argument(help="Bundles", show_default="the default one")] = None,
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    postprocess: Annotated[str | None, typer.Option(help="none, knn or head", show_default="the bundle's")] = None,
    refine: Annotated[str, typer.Option(help="near or all")] = "near",
    threads: int = 2,
    scans: Annotated[int, typer.Option(help="Measured scans (the sequence forwards and backwards)")] = 200,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Percentiles of each stage of the runner, in ms; the history is full. Peak memory is that of the process."""
    frames = load_frames(sequence, 60)
    there_and_back = frames + frames[-2:0:-1]
    results = {}
    for bundle in bundles or [None]:
        runner = MosRunner(bundle, threads=threads, postprocess=postprocess, refine=refine)
        stages: dict[str, list[float]] = {}
        for i in range(HISTORY + scans):
            result = runner(*there_and_back[i % len(there_and_back)])
            for stage, seconds in result.timing.items() if i >= HISTORY else ():
                stages.setdefault(stage, []).append(seconds)
        name = f"{runner.bundle.manifest.name}, {runner.postprocess}"
        results[name] = {stage: summary(seconds) for stage, seconds in stages.items()}
        points = sum(len(scan) for scan, _ in frames) // len(frames)
        show(f"{name}, {points} points a scan, {threads} threads, ms", results[name])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    typer.echo(f"peak resident memory: {peak:.0f} MB")
    save(out, threads, {"points": points, "ms": results, "peak_mb": round(peak)})


if __name__ == "__main__":
    typer.run(bench)
