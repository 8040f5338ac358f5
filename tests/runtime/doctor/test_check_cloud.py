"""Clouds as a LiDAR measures them, thinned out, merged, and moved."""

import numpy as np
import pytest

from runtime.doctor.check_cloud import check_cloud
from runtime.recordings.formats.registry import read_cloud
from runtime.recordings.recording import Indexed, Scan
from tests.support import street
from tests.support.paths import SHARED

FILES = {
    "pcd/pandar40p_binary_timestamp_ring.pcd": 4,
    "pcd/vlp16_binary_padded_ring.pcd": 4,
    "pcd/os0-64_binary_pointxyzinormal.pcd": 4,
    "bin5/000000.bin": 5,
}


class One(Indexed):
    name = source = "one"
    keys = ("000000",)

    def __init__(self, points, ring=None):
        self.scan = Scan("000000", np.asarray(points, np.float32), ring=ring)

    def read(self, index):
        return self.scan


def topics(points, ring=None):
    return [found.topic for found in check_cloud(One(points, ring))]


@pytest.fixture(params=FILES)
def cloud(request, readers):
    return read_cloud(readers / request.param, FILES[request.param])


@pytest.fixture
def readers():
    folder = SHARED / "data" / "readers"
    if not folder.is_dir():
        pytest.skip(f"real files are not at {folder}")
    return folder


def centroids(points, size):
    points = points[np.isfinite(points).all(1)].astype(np.float64)
    _, voxel, counts = np.unique(np.floor(points / size), axis=0, return_inverse=True, return_counts=True)
    return np.stack([np.bincount(voxel.reshape(-1), points[:, axis]) / counts for axis in range(3)], 1)


def test_scans_as_they_were_measured(cloud):
    assert topics(cloud.data[:, :3], cloud.ring) == []


@pytest.mark.parametrize("size", [0.1, 0.2, 0.4])
def test_a_voxel_filter(cloud, size):
    assert topics(centroids(cloud.data[:, :3], size)) == ["thinning"]


def test_the_frame_of_the_vehicle_and_clouds_of_several(cloud):
    points = cloud.data[:, :3]
    if cloud.ring is None:
        return
    moved = points + np.float32([1.2, 0, 1.7])
    assert topics(moved, cloud.ring) == ["origin"]
    both = np.vstack([points, points[:, [1, 0, 2]] * np.float32([-1, 1, 1]) + np.float32([-1.5, 0.5, -1.2])])
    assert "origin" in topics(both, np.tile(cloud.ring, 2))


def test_two_lidars_of_a_car(readers):
    """As Argoverse 1 keeps them, in the frame of the vehicle."""
    cloud = read_cloud(readers / "ply" / "argoverse1.ply")
    assert topics(cloud.data[:, :3], cloud.ring) == ["origin"]


def test_little_tells_nothing():
    scan = street.scan(np.eye(4), street.boxes(), rows=4, columns=20)
    for points in (scan[:, :3], scan[:0, :3], np.full((50, 3), np.nan)):
        assert topics(points, np.zeros(len(points), np.int32)) == []
