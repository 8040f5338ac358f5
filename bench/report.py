"""What every benchmark has in common: where it ran, how times are summed up, and the JSON file."""

import importlib.metadata
import json
import os
import platform
import subprocess
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from runtime.files import write_whole

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "numba", "onnxruntime", "torch", "openvino", "spconv")


def machine(threads: int) -> dict[str, Any]:
    """CPU, threads, versions and commit of this run."""
    cpu = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        cpu = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), cpu)
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
    return {
        "cpu": cpu,
        "threads": threads,
        "python": platform.python_version(),
        "versions": versions,
        "commit": commit.stdout.strip(),
        "date": time.strftime("%Y-%m-%d"),
    }


def resident_mb() -> float:
    """Resident memory of this process now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def interleaved(tasks: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each task, in turn A B C A B C ..., after one warm-up of each."""
    for task in tasks.values():
        task()
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, task in tasks.items():
            started = time.perf_counter()
            task()
            seconds[name].append(time.perf_counter() - started)
    return seconds


def summary(seconds: list[float]) -> dict[str, Any]:
    """Milliseconds: median and range; p95 and p99 where there are samples enough."""
    ms = 1e3 * np.asarray(seconds)
    found = {"median": float(np.median(ms)), "min": float(ms.min()), "max": float(ms.max()), "runs": len(ms)}
    if len(ms) >= 20:
        found["p95"] = float(np.percentile(ms, 95))
    if len(ms) >= 100:
        found["p99"] = float(np.percentile(ms, 99))
    return {key: value if key == "runs" else round(value, 2) for key, value in found.items()}


def show(title: str, rows: Mapping[str, Mapping[str, Any]]) -> None:
    """Print rows (name -> column -> value) as a table."""
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for column in columns:
        table.add_column(column, justify="right")
    for name, row in rows.items():
        values = (row.get(column, "") for column in columns)
        table.add_row(name, *(f"{value:.2f}" if isinstance(value, float) else str(value) for value in values))
    Console().print(table)


def brief(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Rows of a wide table without what is only in the JSON file."""
    left_out = ("min", "max", "runs", "p95", "p99")
    return {name: {key: value for key, value in row.items() if key not in left_out} for name, row in rows.items()}


def save(path: Path | None, threads: int, results: Mapping[str, Any]) -> None:
    """Write the results with the machine as JSON."""
    if path is not None:
        write_whole(path, (json.dumps({"machine": machine(threads), **results}, indent=2) + "\n").encode())
        Console().print(f"written: {path}", highlight=False, soft_wrap=True)
