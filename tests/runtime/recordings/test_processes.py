"""A recording goes to other processes, as those that make training samples."""

import pickle

import numpy as np
import pytest

from runtime.recordings.registry import open_recording
from tests.support import street


@pytest.mark.parametrize("poses", ["camera", "lidar"])
def test_it_is_the_same_there(poses, tmp_path):
    folder = street.write_kitti(tmp_path / "sequences" / "00", 4)
    if poses == "lidar":
        (folder / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    here = open_recording(folder)
    there = pickle.loads(pickle.dumps(here))
    assert np.array_equal(there.read(2).data, here.read(2).data)
    assert np.array_equal(there.poses, here.poses)
    assert there.other_poses().keys() == here.other_poses().keys()
