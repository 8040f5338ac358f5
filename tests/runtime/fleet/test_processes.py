"""Processes that label side by side, and die."""

import multiprocessing
import os
import shutil
import signal

import pytest

from runtime.errors import BundleError
from runtime.fleet import processes
from runtime.fleet.events import Done, Said, Scans
from runtime.fleet.here import label_here
from runtime.fleet.processes import label_in_processes
from tests.runtime.fleet.conftest import COUNT, labels

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills processes as POSIX does")


def done(heard):
    return {one.name: one for one in heard if isinstance(one, Done)}


def test_one_after_the_other_and_again(paths, plain, work_at, tmp_path):
    heard = []
    for _ in range(2):
        label_here(work_at(tmp_path), paths, hear=heard.append)
    assert labels(tmp_path) == plain
    assert [(one.scans, one.resumed) for one in heard if isinstance(one, Done)] == [(COUNT, 0)] * 3 + [(0, COUNT)] * 3


def test_a_process_that_is_killed(paths, plain, work_at, tmp_path, monkeypatch):
    """Its recording is tried again, and goes on where it was; one that kills each of them is named, and left."""
    monkeypatch.setattr(processes, "AGAIN", 1)
    heard, to_kill = [], ["01", "02", "02"]

    def hear(event):
        heard.append(event)
        if isinstance(event, Scans) and event.done == 5 and to_kill[:1] == [event.name]:
            for child in multiprocessing.active_children():
                os.kill(child.pid, signal.SIGKILL)
            to_kill.pop(0)

    label_in_processes(work_at(tmp_path), paths, jobs=1, hear=hear)
    ended = done(heard)
    assert to_kill == []
    assert (ended["01"].error, ended["03"].error) == ("", "")
    assert ended["01"].resumed >= 5
    assert ended["01"].scans + ended["01"].resumed == COUNT
    assert ended["02"].error == "its process died (by SIGKILL), 2 times in a row"
    again = [one for one in heard if isinstance(one, Said) and "tried again" in one.text]
    assert [(one.name, one.warning) for one in again] == [("01", True), ("02", True)]
    assert labels(tmp_path).items() < plain.items()  # what is there is whole
    assert not multiprocessing.active_children()

    label_in_processes(work_at(tmp_path), paths, jobs=2, hear=heard.append)  # the same command again
    assert labels(tmp_path) == plain
    assert done(heard)["02"].error == ""


def test_an_interrupt_ends_all(paths, plain, work_at, tmp_path):
    def hear(event):
        if isinstance(event, Scans) and event.done == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        label_in_processes(work_at(tmp_path), paths, jobs=1, hear=hear)
    assert not multiprocessing.active_children()
    assert labels(tmp_path).items() < plain.items()
    assert not list(tmp_path.rglob("*.part"))


def test_another_bundle_than_the_others_have(paths, work_at, tmp_path):
    work = work_at(tmp_path / "out")
    other = shutil.copytree(work.bundle, tmp_path / "bundle")
    (other / "manifest.json").write_text((other / "manifest.json").read_text() + "\n")
    object.__setattr__(work, "bundle", other)
    with pytest.raises(BundleError, match="another version or bundle than the others"):
        label_in_processes(work, paths, jobs=1, hear=lambda event: None)
    assert not (tmp_path / "out").exists()
