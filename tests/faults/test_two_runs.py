"""One folder, two runs: the second is told so, and a run that is gone keeps nothing."""

import os
import shutil
import subprocess
import sys

import pytest

from runtime import MosRunner
from runtime.commands.terminal_voice import TerminalVoice
from runtime.errors import OutputError
from runtime.files import locked
from runtime.fleet import labelling
from runtime.fleet.wanted import Wanted
from runtime.predict import predict
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support.paths import ROOT, TINY

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs locks of POSIX")

HOLD = """
import sys, time
from pathlib import Path
from runtime.files import locked
from runtime.commands.terminal_voice import TerminalVoice
from runtime.fleet import labelling
from runtime.fleet.wanted import Wanted
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process, within a run of the first sequence."""
    place = tmp_path / "out" / "sequences" / "00"
    with subprocess.Popen([sys.executable, "-c", HOLD, str(place)], cwd=ROOT, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()


def test_a_run_beside_another(tmp_path, holder):
    recording = open_recording(TINY / "scans" / "sequences" / "00")
    with MosRunner(TINY / "bundle", threads=1, postprocess="none") as runner:
        for overwrite in (False, True):
            with pytest.raises(OutputError, match="another run writes there"):
                predict(recording, runner, tmp_path / "out", overwrite=overwrite)
        assert not list((tmp_path / "out").rglob("*.label"))
        holder.kill()  # a process that is gone keeps no lock
        holder.wait()
        assert predict(recording, runner, tmp_path / "out").scans == len(recording)


def test_what_is_made_of_all_labels_is_made_within_the_lock(tmp_path, monkeypatch):
    """Else a run that begins meanwhile deletes what is not whole yet, as left by one that was killed."""
    held = []

    def write(recording, labels, *others):
        with pytest.raises(OutputError, match="another run writes there"), locked(labels.parent, wait=0):
            pass
        held.append(labels)

    monkeypatch.setattr(labelling, "_write_left", write)
    recording, out = open_recording(TINY / "scans" / "sequences" / "00"), tmp_path / "out"
    with MosRunner(TINY / "bundle", threads=1, postprocess="none") as runner:
        labelling.label(recording, runner, Options(), out, False, Wanted(map=True), TerminalVoice())
    assert held == [out / "sequences" / "00" / "predictions"]


def test_a_lock_is_let_go(tmp_path):
    for _ in range(2):
        with locked(tmp_path), pytest.raises(OutputError), locked(tmp_path):
            pass
    shutil.rmtree(tmp_path)  # nothing is left open
    with locked(tmp_path):
        assert os.listdir(tmp_path) == []
