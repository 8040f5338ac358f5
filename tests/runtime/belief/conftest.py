"""A little street, and the tiny bundle with a short horizon of belief."""

import json
import shutil

import numpy as np
import pytest

from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner
from tests.support import street
from tests.support.paths import BUNDLE

PLACES, TRAIL = 3, 1  # scans that what is believed of a place, and of an object, depends on
HORIZON = PLACES + TRAIL
COUNT = 17  # more than a result depends on


def files(out):
    """Labels by name."""
    return {file.name: file.read_bytes() for file in sorted(out.rglob("*.label"))}


@pytest.fixture(scope="package")
def made(tmp_path_factory):
    return street.write_kitti(tmp_path_factory.mktemp("street") / "07", COUNT, rows=16, columns=120)


@pytest.fixture(scope="package")
def scans(made):
    return [(scan.data, scan.known_pose()) for scan in open_recording(made)]


@pytest.fixture(scope="package")
def bundle(scans, tmp_path_factory):
    """The tiny bundle, with a threshold that its untrained network passes for about half of the points."""
    folder = shutil.copytree(BUNDLE, tmp_path_factory.mktemp("bundle") / "tiny")
    with MosRunner(folder, threads=1, postprocess="none") as plain:
        middle = float(np.median(np.concatenate([plain(*scan).probability for scan in scans])))
    manifest = json.loads((folder / "manifest.json").read_text())
    numbers = {"horizon": PLACES, "voxel_size": 0.5, "weight": 0.5, "look_back": 0, "longest_trail": TRAIL}
    manifest["tuned"]["belief"] = numbers
    for sensor in manifest["sensors"]:
        sensor["decision"] |= {"belief_threshold": middle, "delayed_threshold": middle}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder
