"""How many processors this process may use."""

import os
from pathlib import Path, PurePosixPath


def available_processors(root: Path = Path("/")) -> int:
    """Processors that this process may run on, at most as many as its control groups grant it the time of, at least 1.

    root: where to look for Linux's files of control groups, versions 1 and 2.
    """
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, int(min(count, *_quotas(root))))


def _quotas(root: Path) -> list[float]:
    """Processors' worth of time that each control group of this process grants, or infinity."""
    quotas = [float("inf")]
    for line in _read(root / "proc/self/cgroup").splitlines():
        _, _, group = line.partition(":")
        controllers, _, path = group.partition(":")
        for folder in _groups(root / "sys/fs/cgroup", controllers, path):
            quotas += [_version_2(folder), _version_1(folder)]
    return quotas


def _groups(mount: Path, controllers: str, path: str) -> list[Path]:
    """Folders of a control group and those above it, whose limits hold for it too.

    In a container `path` may be that of the host, of which only the last folder is there, as the uppermost.
    """
    if not controllers:  # version 2; beside version 1 it lies in a folder of its own
        mounts = [mount, mount / "unified"]
    elif "cpu" in controllers.split(","):
        mounts = [mount / "cpu", mount / controllers]
    else:
        return []
    inside = PurePosixPath(path.lstrip("/"))
    if ".." in inside.parts:  # outside of what this process sees
        inside = PurePosixPath()
    return [base / part for base in mounts for part in (inside, *inside.parents)]


def _version_2(folder: Path) -> float:
    """From `cpu.max`: "200000 100000" or "max 100000", microseconds of each period."""
    quota, _, period = _read(folder / "cpu.max").partition(" ")
    return _share(quota, period)


def _version_1(folder: Path) -> float:
    """From `cpu.cfs_quota_us`, -1 without a limit, and `cpu.cfs_period_us`."""
    return _share(_read(folder / "cpu.cfs_quota_us"), _read(folder / "cpu.cfs_period_us"))


def _share(quota: str, period: str) -> float:
    try:
        share = int(quota) / int(period)
    except (ValueError, ZeroDivisionError):  # "max", or no such file
        return float("inf")
    return share if share > 0 else float("inf")


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return ""
