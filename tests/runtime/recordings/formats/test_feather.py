import numpy as np
import pytest

from runtime.compute import packages
from runtime.errors import MissingPackageError, ScanError
from runtime.recordings.formats.registry import count_points, read_cloud

feather = pytest.importorskip("pyarrow.feather")
pyarrow = pytest.importorskip("pyarrow")


@pytest.fixture
def path(tmp_path, scan):
    columns = dict(zip(("x", "y", "z", "intensity"), scan.T, strict=True))
    feather.write_feather(pyarrow.table(columns | {"laser_number": np.arange(200) % 64}), tmp_path / "a.feather")
    return tmp_path / "a.feather"


def test_scans_come_back_bit_for_bit(path, scan):
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.data, scan)
    np.testing.assert_array_equal(cloud.ring, np.arange(200) % 64)
    assert count_points(path) == 200


def test_cut_off(path):
    path.write_bytes(path.read_bytes()[:-500])
    with pytest.raises(ScanError, match=r"a\.feather: cannot be read as Feather"):
        read_cloud(path)


def test_other_columns(path):
    feather.write_feather(pyarrow.table({"classes": [1, 2]}), path)
    with pytest.raises(ScanError, match="no field x, y, z; its fields are classes"):
        read_cloud(path)


def test_without_the_package(path, monkeypatch):
    monkeypatch.setattr(packages, "has_package", lambda name: False)
    with pytest.raises(MissingPackageError, match=r"lidar-mos\[argoverse\]"):
        read_cloud(path)
