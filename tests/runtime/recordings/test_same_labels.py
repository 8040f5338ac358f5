"""A drive written in every format gets the same labels, with the same pose file."""

from functools import partial

import numpy as np
import pytest

from runtime.predict import predict
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner
from tests.support import street
from tests.support.bag_writers import KINDS, BagWriter
from tests.support.paths import BUNDLE
from tests.support.scan_writers import write_las, write_pcd, write_ply

COUNT = 10


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A KITTI sequence whose last scans begin with points without a return."""
    folder = street.write_kitti(tmp_path_factory.mktemp("kitti") / "07", COUNT, rows=64, columns=180)
    for path in sorted((folder / "velodyne").iterdir())[5:]:
        scan = np.fromfile(path, np.float32).reshape(-1, 4)
        scan[:7] = np.nan
        scan.tofile(path)
    return folder


@pytest.fixture(scope="module")
def labels_of(drive, tmp_path_factory):
    """Labels of a recording of this drive with the poses of the KITTI sequence, (T, N)."""
    runner = MosRunner(BUNDLE, threads=1)
    options = Options(poses=drive / "poses.txt", calib=drive / "calib.txt")

    def call(path):
        summary = predict(open_recording(path, options), runner, tmp_path_factory.mktemp("out"))
        return [np.fromfile(file, np.uint32) for file in sorted(summary.folder.iterdir())]

    return call


@pytest.fixture(scope="module")
def expected(drive, labels_of):
    labels = labels_of(drive)
    assert len(labels) == COUNT
    assert any((one == 251).any() for one in labels)
    return labels


@pytest.fixture
def scans(drive):
    return [np.fromfile(path, np.float32).reshape(-1, 4) for path in sorted((drive / "velodyne").iterdir())]


FOLDERS = {
    "0.pcd": [partial(write_pcd, encoding=one) for one in ("ascii", "binary", "binary_compressed")],
    "0.ply": [partial(write_ply, encoding=one) for one in ("ascii", "binary_little_endian", "binary_big_endian")],
}


@pytest.mark.parametrize(("name", "write"), [(name, write) for name, some in FOLDERS.items() for write in some])
def test_folders(scans, labels_of, expected, tmp_path, name, write):
    if "compressed" in write.keywords["encoding"]:
        pytest.importorskip("lzf")
    (tmp_path / "log").mkdir()
    for number, scan in enumerate(scans):
        write(tmp_path / "log" / name.replace("0", str(number)), scan)
    for found, wanted in zip(labels_of(tmp_path / "log"), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_keeps_a_tenth_of_a_millimetre(scans, labels_of, expected, tmp_path, suffix):
    pytest.importorskip("laspy")
    pytest.importorskip("lazrs")
    (tmp_path / "log").mkdir()
    for number, scan in enumerate(scans):
        write_las(tmp_path / "log" / f"{number}{suffix}", np.nan_to_num(scan))  # it knows no NaN: the origin
    found, wanted = (np.concatenate(labels) for labels in (labels_of(tmp_path / "log"), expected))
    assert (found != wanted).mean() <= 1e-3  # of a network that is not trained


@pytest.mark.parametrize("kind", KINDS)
def test_bags(scans, labels_of, expected, tmp_path, kind):
    pytest.importorskip("rosbags")
    path = tmp_path / ("log.bag" if kind == "bag" else "log")
    with BagWriter(path, kind) as bag:
        for number, scan in enumerate(scans):
            bag.cloud(scan, 0.1 * number)
    for found, wanted in zip(labels_of(path), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)
