"""Does it stay as fast and as small, one runner or several side by side: `python -m bench.steadiness`."""

import os
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from bench.report import resident_mb, save, show, summary
from bench.scans import load_frames, there_and_back
from runtime import MosRunner
from runtime.commands.handler import run_alone
from runtime.sensors.registry import DEFAULT_SENSOR

SETTLED = 50  # scans of each runner, after which nothing must grow
LOOKS = 10  # at what is held, after that


def bench(
    bundle: Annotated[Path | None, typer.Argument(help="Bundle", show_default="the default one")] = None,
    sequence: Annotated[Path | None, typer.Option(help="A KITTI sequence; else a simulated street")] = None,
    sensor: Annotated[str, typer.Option(help="Of the simulated street")] = DEFAULT_SENSOR,
    postprocess: Annotated[str | None, typer.Option(help="none, knn or head", show_default="the bundle's")] = None,
    threads: Annotated[int, typer.Option(help="Of each runner")] = 2,
    runners: Annotated[int, typer.Option(min=1, help="Each called by a thread of its own")] = 1,
    scans: Annotated[int, typer.Option(min=SETTLED + LOOKS, help="Of each: the sequence there and back")] = 2000,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Percentiles of the time of a scan; memory, descriptors and threads of the process after 50 scans of each runner,
    and from then on to the last."""
    frames = load_frames(sequence, 60, sensor)
    order = there_and_back(frames)
    made = [MosRunner(bundle, threads=threads, postprocess=postprocess) for _ in range(runners)]
    looks = [int(at) for at in np.linspace(SETTLED, scans, LOOKS + 1)]
    held: list[dict[str, float]] = []
    wall, cpu = np.ones((2, runners, scans))  # s, all of it in memory from the start
    meeting = threading.Barrier(runners, lambda: held.append(_held()))  # nobody is within a scan there

    def label(number: int) -> None:
        try:
            for i in range(scans):
                started, used = time.perf_counter(), time.process_time()
                made[number](*order[i % len(order)])
                wall[number, i], cpu[number, i] = time.perf_counter() - started, time.process_time() - used
                if i + 1 in looks:
                    meeting.wait()
        except BaseException:
            meeting.abort()  # else the others would wait for ever
            raise

    with ThreadPoolExecutor(runners) as pool:
        list(pool.map(label, range(runners)))
    rows: dict[str, dict[str, Any]] = {"wall time, ms": summary(wall[:, SETTLED:].ravel().tolist())}
    if runners == 1:  # the process does nothing else
        rows["CPU time, ms"] = summary(cpu[0, SETTLED:].tolist())
    for row in rows.values():
        row["p99 / median"] = round(row["p99"] / row["median"], 3)
    one = made[0]
    name = f"{one.bundle.manifest.name}, {one.postprocess}, belief {one.belief}"
    show(f"{name}, {runners} x {threads} threads, {scans} scans of each", rows)
    after = {str(at): look for at, look in zip(looks, held, strict=True)}
    show("held after so many scans of each", after)
    growth = held[-1]["own MB"] - held[0]["own MB"]
    typer.echo(f"memory: {growth:+.1f} MB since scan {SETTLED}")
    drive = {
        "sensor": one.sensor.name if one.sensor else None,
        "points": int(np.mean([len(scan) for scan, _ in frames])),
        "belief": one.belief,
    }
    results = {"runners": runners, "scans": scans, **drive, "times": rows, "held": after, "growth_mb": round(growth, 1)}
    save(out, threads, results)


def _held() -> dict[str, float]:
    """What this process has of the machine: memory of its own is without pages of files, which Linux takes back."""
    status = dict(line.split(":\t", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return {
        "resident MB": round(resident_mb(), 2),
        "own MB": int(status["RssAnon"].split()[0]) * 1024 / 1e6,
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": int(status["Threads"]),
    }


if __name__ == "__main__":
    sys.exit(run_alone(bench, "steadiness"))
