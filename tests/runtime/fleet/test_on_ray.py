"""A cluster of Ray, of this machine alone."""

import contextlib
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from runtime.errors import MosError
from runtime.fleet.events import Done
from runtime.fleet.on_ray import label_on_ray
from tests.runtime.fleet.conftest import COUNT, labels
from tests.support.paths import ROOT

pytest.importorskip("ray", reason="needs the extra 'fleet'")
pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc"),
    pytest.mark.filterwarnings("ignore"),  # what Ray itself does
]


@pytest.mark.parametrize("piece", [None, 15])
def test_a_worker_that_is_killed(piece, paths, plain, work_at, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
    killed = []

    def kill():
        while len(labels(tmp_path)) < 4:
            time.sleep(0.002)
        for process in workers():
            os.kill(process, signal.SIGKILL)
            killed.append(process)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    heard = []
    label_on_ray(replace(work_at(tmp_path), piece=piece), paths, address=None, hear=heard.append)
    thread.join()
    assert killed
    assert os.environ["RAY_USAGE_STATS_ENABLED"] == "0"
    done = [one for one in heard if isinstance(one, Done)]
    assert sorted((one.name, one.error) for one in done) == [("01", ""), ("02", ""), ("03", "")]
    assert {one.scans + one.resumed for one in done} == {COUNT}
    assert any(one.resumed for one in done)
    assert labels(tmp_path) == plain


def test_no_cluster(paths, work_at, tmp_path):
    with pytest.raises(MosError, match="no cluster of Ray at ray://localhost:1"):
        label_on_ray(work_at(tmp_path), paths, address="ray://localhost:1", hear=lambda event: None)


def workers():
    """Processes below this one that run such a task: Ray calls them by its name."""
    above = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it is gone
            above[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    return [one for one in above if is_below(one, above) and b"_label" in Path(f"/proc/{one}/cmdline").read_bytes()]


def is_below(process, above):
    while process in above:
        process = above[process]
        if process == os.getpid():
            return True
    return False
