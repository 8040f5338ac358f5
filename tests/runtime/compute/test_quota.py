"""Processors that a process may use, with the files that Linux shows it in containers of several kinds."""

import os
from pathlib import Path

import pytest

from runtime import MosRunner, runner
from runtime.compute.quota import available_processors
from tests.support.paths import BUNDLE

V2, V1 = "sys/fs/cgroup", "sys/fs/cgroup/cpu,cpuacct"
IN_V1 = "3:cpuset:/docker/abc\n4:cpu,cpuacct:/docker/abc\n0::/\n"


@pytest.fixture(autouse=True)
def many_processors(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(32)), raising=False)


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize(
    ("cgroup", "files", "count"),
    [
        ("0::/\n", {f"{V2}/cpu.max": "200000 100000\n"}, 2),
        ("0::/\n", {f"{V2}/cpu.max": "250000 100000\n"}, 2),
        ("0::/\n", {f"{V2}/cpu.max": "50000 100000\n"}, 1),
        ("0::/\n", {f"{V2}/cpu.max": "max 100000\n"}, 32),
        ("0::/\n", {f"{V2}/cpu.max": "9900000 100000\n"}, 32),
        ("0::/a/b\n", {f"{V2}/a/b/cpu.max": "max 100000\n", f"{V2}/a/cpu.max": "300000 100000\n"}, 3),
        ("0::/a/b\n", {f"{V2}/a/b/cpu.max": "400000 100000\n", f"{V2}/a/cpu.max": "500000 100000\n"}, 4),
        ("0::/docker/abc\n", {f"{V2}/cpu.max": "200000 100000\n"}, 2),
        ("0::/../other\n", {f"{V2}/cpu.max": "200000 100000\n"}, 2),
        ("1:name=systemd:/a\n0::/a\n", {f"{V2}/unified/a/cpu.max": "300000 100000\n"}, 3),
        (IN_V1, {f"{V1}/docker/abc/cpu.cfs_quota_us": "200000\n", f"{V1}/docker/abc/cpu.cfs_period_us": "100000\n"}, 2),
        (IN_V1, {f"{V1}/cpu.cfs_quota_us": "150000\n", f"{V1}/cpu.cfs_period_us": "50000\n"}, 3),
        (IN_V1, {f"{V1}/cpu.cfs_quota_us": "-1\n", f"{V1}/cpu.cfs_period_us": "100000\n"}, 32),
        ("1:cpu:/\n", {"sys/fs/cgroup/cpu/cpu.cfs_quota_us": "70", "sys/fs/cgroup/cpu/cpu.cfs_period_us": "0"}, 32),
        ("0::/\n", {f"{V2}/cpu.max": ""}, 32),
        ("0::/\n", {f"{V2}/cpu.max": "no number\n"}, 32),
        ("garbage\n", {}, 32),
    ],
)
def test_no_more_than_the_control_group_grants(tmp_path, cgroup, files, count):
    assert available_processors(write(tmp_path, {"proc/self/cgroup": cgroup, **files})) == count


def test_without_control_groups_those_that_it_may_run_on(tmp_path, monkeypatch):
    assert available_processors(tmp_path) == 32
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    assert available_processors(tmp_path) == 6
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert available_processors(tmp_path) == 1


def test_the_affinity_counts_too(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3}, raising=False)
    assert available_processors(write(tmp_path, {"proc/self/cgroup": "0::/\n", f"{V2}/cpu.max": "200000 100000"})) == 1


def test_a_runner_takes_as_many_threads(monkeypatch):
    monkeypatch.setattr(runner, "available_processors", lambda: 3)
    assert MosRunner(BUNDLE, postprocess="none").workers.threads == 3
