"""What lies where a file should, and is none: a pipe, a device, a link that leads to itself."""

import os
import shutil
from pathlib import Path

import pytest

from runtime.bundle.loading import load_bundle
from runtime.commands.main import main
from runtime.errors import MosError
from runtime.files import open_ordinary, read_ordinary
from runtime.recordings.labels import read_truth
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.registry import open_recording
from runtime.sensors.registry import open_sensor
from tests.support.paths import TINY

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs files of POSIX")

SUFFIXES = (".bin", ".npy", ".pcd", ".ply")


def pipe(path):
    os.mkfifo(path)


def device(path):
    path.symlink_to("/dev/zero")


def loop(path):
    path.symlink_to(path.name)


KINDS = pytest.mark.parametrize("make", [pipe, device, loop])


@pytest.fixture
def recording(tmp_path):
    return Path(shutil.copytree(TINY / "scans" / "sequences" / "00", tmp_path / "sequences" / "00"))


def replaced(path, make):
    path.unlink()
    make(path)


@KINDS
def test_reading_does_not_wait(tmp_path, make):
    make(tmp_path / "x")
    for read in (open_ordinary, read_ordinary):
        with pytest.raises(OSError, match=r"no ordinary file|symbolic links"):
            read(tmp_path / "x")


@KINDS
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_scans(tmp_path, make, suffix):
    make(tmp_path / f"000000{suffix}")
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    for path in (tmp_path, tmp_path / f"000000{suffix}"):
        assert main(["run", str(path), "--pose-frame", "lidar", "--out", str(tmp_path / "out")]) in (1, 2)


@KINDS
def test_labels_and_poses(recording, make):
    label = next((recording / "labels").glob("*.label"))
    replaced(label, make)
    with pytest.raises(MosError):
        read_truth(label)
    for name in ("poses.txt", "calib.txt"):
        replaced(recording / name, make)
        with pytest.raises(MosError):
            read_pose_table(recording / name)
        with pytest.raises(MosError):
            open_recording(recording)


@KINDS
@pytest.mark.parametrize("name", ["manifest.json", "image_net.onnx", "point_head.npz"])
def test_bundles(bundle, make, name, capfd):
    replaced(bundle / name, make)
    with pytest.raises(MosError, match=name):
        load_bundle(bundle)
    assert main(["info", str(bundle)]) == 1
    assert len(capfd.readouterr().err.splitlines()) == 1


@KINDS
@pytest.mark.parametrize("name", ["run.json", "scans.jsonl"])
def test_what_a_run_goes_on_from(recording, tmp_path, make, name):
    common = ["--limit", "2", "--threads", "1", "--postprocess", "none", "--out", str(tmp_path / "out")]
    command = ["run", str(recording), "--bundle", str(TINY / "bundle"), *common]
    assert main(command) == 0
    replaced(tmp_path / "out" / "sequences" / "00" / name, make)
    assert main(command) == (0 if (name, make) == ("scans.jsonl", loop) else 1)  # a link to nothing is replaced


@KINDS
def test_sensors(tmp_path, make):
    make(tmp_path / "own.json")
    with pytest.raises(MosError):
        open_sensor(tmp_path / "own.json")


@KINDS
def test_checkpoints(tmp_path, make):
    from export.checkpoint.reader import read_tensors
    from mos_model.networks.checkpoint import read

    make(tmp_path / "x.pt")
    for reader in (read_tensors, read):
        with pytest.raises(MosError):
            reader(tmp_path / "x.pt")
