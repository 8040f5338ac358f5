"""The Python in the READMEs runs."""

import shutil

import pytest

from runtime.recordings.registry import open_recording
from tests.support.markdown import blocks, documents, run
from tests.support.paths import ROOT, TINY

ELSEWHERE = ("CONTRIBUTING.md", "CHANGELOG.md")  # tests of what they show run it
EXAMPLES = [file for file in documents() if file.name not in ELSEWHERE and blocks(file, "python")]


@pytest.fixture
def names(tmp_path, monkeypatch):
    """A folder with a recording, a bundle and a checkpoint to work in, and what the examples take for given."""
    shutil.copytree(TINY / "scans", tmp_path / "kitti")
    shutil.copytree(TINY / "bundle", tmp_path / "my" / "bundle")
    shutil.copyfile(TINY / "checkpoint.pt", tmp_path / "my" / "checkpoint.pt")
    monkeypatch.chdir(tmp_path)
    stream = [(scan.data, scan.pose) for scan in open_recording("kitti")]
    return {"stream": stream, "scan": stream[0][0], "pose": stream[0][1]}


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: str(file.relative_to(ROOT)))
def test_examples_run(file, names):
    for block in blocks(file, "python"):
        run(file, block, names)
