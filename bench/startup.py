"""Time to the first result, peak memory and size of the installation: `python -m bench.startup BUNDLE`."""

import importlib.metadata
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from bench.report import save, show, summary
from runtime.commands.handler import run_alone

CHILD = """
import json, os, resource, sys, time
ticks = int(open("/proc/self/stat").read().rsplit(")", 1)[1].split()[19])  # from boot to the start of this process
started = time.time() - time.clock_gettime(time.CLOCK_BOOTTIME) + ticks / os.sysconf("SC_CLK_TCK")
from pathlib import Path
import numpy as np
from runtime import MosRunner
drive = np.load(sys.argv[2])
runner = MosRunner(sys.argv[1], threads=int(sys.argv[3]))
runner(drive["scan0"], drive["pose0"])
first = time.time() - started
for i in range(1, len(drive.files) // 2):
    runner(drive[f"scan{i}"], drive[f"pose{i}"])
print(json.dumps([first, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


def installed_sizes(name: str, seen: dict[str, float]) -> dict[str, float]:
    """MB on disk of a distribution and all that it needs."""
    if name.lower() in seen:
        return seen
    try:
        distribution = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return seen
    files = distribution.files or []
    paths = [Path(str(file.locate())) for file in files if ".pyc" not in file.name]
    seen[name.lower()] = sum(path.stat().st_size for path in paths if path.is_file()) / 1e6
    for requirement in distribution.requires or []:
        if "extra ==" not in requirement:
            installed_sizes(re.split(r"[^\w.-]", requirement)[0], seen)
    return seen


def bench(
    bundle: Annotated[Path, typer.Argument(help="A bundle")],
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    threads: int = 2,
    rounds: int = 5,
    scans: Annotated[int, typer.Option(help="Scans after the first, for the peak of memory")] = 30,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """From the start of a process to its first result, kernels compiled before; peak resident memory."""
    import tempfile

    import numpy as np

    from bench.scans import load_frames

    frames = load_frames(sequence, 1 + scans)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.npz"
        scans_and_poses = {f"scan{i}": scan for i, (scan, _) in enumerate(frames)}
        np.savez(path, **scans_and_poses, **{f"pose{i}": pose for i, (_, pose) in enumerate(frames)})
        command = [sys.executable, "-c", CHILD, str(bundle), str(path), str(threads)]
        runs = []
        for _ in range(rounds + 1):
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            runs.append(json.loads(done.stdout.splitlines()[-1]))
    first, peak = zip(*runs[1:], strict=True)
    points = len(frames[0][0])
    show(f"start to first result, {points} points, {threads} threads, ms", {str(bundle): summary(list(first))})
    typer.echo(f"peak resident memory: {max(peak):.0f} MB")
    sizes = dict(sorted(installed_sizes("lidar-mos", {}).items(), key=lambda item: -item[1]))
    rows = {name: {"MB": round(size, 1)} for name, size in (sizes | {"together": sum(sizes.values())}).items()}
    show("installed", rows)
    save(out, threads, {"first_result_ms": summary(list(first)), "peak_mb": max(peak), "installed_mb": sizes})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "startup"))
