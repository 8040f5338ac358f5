"""A new format is one file, as CONTRIBUTING has it, and one line in `READERS`: then all of `mos` takes it."""

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.recordings import registry
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.paths import BUNDLE


@pytest.fixture
def drive(tmp_path, contributed, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    archive = contributed("runtime/recordings/archive.py")
    monkeypatch.setattr(registry, "READERS", (*registry.READERS, archive))
    poses, world = street.drive(12), street.boxes()
    points = {f"points_{i}": street.scan(pose, world)[:, :3] for i, pose in enumerate(poses)}
    np.savez(tmp_path / "monday.npz", poses=poses, times=0.1 * np.arange(12), **points)
    return tmp_path / "monday.npz"


def test_its_recordings_have_all_that_they_need(drive):
    recording = open_recording(drive)
    assert (recording.name, len(recording), recording.sensor) == ("monday", 12, "hdl32e")
    assert [scan.key for scan in recording.scans(10)] == ["000010", "000011"]
    assert recording.count(3) == len(recording.read(3).points)
    assert recording.read(3).remission is None
    assert recording.labels(3) is None
    assert recording.fingerprint(recording.read(3)) != recording.fingerprint(recording.read(4))
    np.testing.assert_allclose(recording.other_poses()["inverse"] @ recording.poses, [np.eye(4)] * 12, atol=1e-12)


def test_mos_takes_it(drive, tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["run", str(drive), "--out", str(out), "--bundle", str(BUNDLE), "--limit", "5"]
    assert main(arguments) == 0
    shown = capsys.readouterr()
    assert "sequence monday: 5 scans" in shown.out
    labels = sorted((out / "sequences" / "monday" / "predictions").iterdir())
    assert [file.name for file in labels] == [f"{i:06d}.label" for i in range(5)]
    assert all(file.stat().st_size == 4 * len(np.load(drive)[f"points_{i}"]) for i, file in enumerate(labels))
    assert main(arguments) == 0
    assert "0 scans, 5 were there already" in capsys.readouterr().out


def test_the_doctor_takes_it(drive, capsys):
    assert main(["doctor", str(drive), "--bundle", str(BUNDLE)]) == 0
    shown = capsys.readouterr().out
    assert "12 scans" in shown
    assert "poses and scans fit" in shown
    assert "0.10 s a scan" in shown
    arrays = dict(np.load(drive))
    np.savez(drive, **arrays | {"poses": np.linalg.inv(arrays["poses"])})
    assert main(["doctor", str(drive), "--bundle", str(BUNDLE)]) == 1
    assert "they are inverted" in capsys.readouterr().out


def test_mos_draws_it(drive, tmp_path):
    pytest.importorskip("PIL")
    pytest.importorskip("PIL")
    assert main(["view", str(drive), "--out", str(tmp_path / "a.png"), "--bundle", str(BUNDLE)]) == 0
    assert (tmp_path / "a.png").stat().st_size > 1000
