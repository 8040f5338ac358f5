"""Where an odometry was lost is known to whoever reads its poses again."""

import logging
import shutil

import numpy as np
import pytest

from runtime.errors import LostError, MosWarning
from runtime.odometry.with_poses import with_poses
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street

COUNT, LOST = 5, 3


class Line:
    """An odometry that goes straight on, and is lost once."""

    name = "straight on"

    def __init__(self):
        self.asked, self.ready = 0, False

    def locate(self, data, time, times):
        if self.asked == LOST and not self.ready:
            self.ready = True
            raise LostError("fog")
        self.asked += 1
        pose = np.eye(4)
        pose[0, 3] = 0.5 * self.asked
        return pose


@pytest.fixture
def folder(tmp_path):
    """Scans without poses of their own."""
    made = street.write_kitti(tmp_path / "07", COUNT, rows=8, columns=60)
    for name in ("poses.txt", "calib.txt"):
        (made / name).unlink()
    (made / "times.txt").write_text("".join(f"{0.1 * index}\n" for index in range(COUNT)))
    return made


@pytest.fixture
def out(folder, tmp_path):
    """What was found, and written."""
    with pytest.warns(MosWarning, match="1 scans lie"):
        with_poses(open_recording(folder, Options(given_poses="ignored")), Line(), folder=tmp_path / "out")
    return tmp_path / "out"


def lost(recording):
    """By the recording and by its scans."""
    assert [scan.lost for scan in recording] == [recording.lost.get(index, "") for index in range(len(recording))]
    return dict(recording.lost)


def test_breaks_go_with_the_files(folder, out, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    kitti = Options(poses=out / "poses.txt", calib=out / "calib.txt")
    assert lost(open_recording(folder, kitti)) == {LOST: "fog"}
    assert "straight on was lost at 000003" in caplog.text
    assert lost(open_recording(folder, Options(poses=out / "poses.tum", frame="lidar"))) == {LOST: "fog"}
    assert lost(open_recording(folder, Options(poses=out / "poses.txt", calib=out / "calib.txt", limit=2))) == {}
    for name in ("poses.txt", "calib.txt", "odometry.json"):
        shutil.copy(out / name, folder / name)
    assert lost(open_recording(folder)) == {LOST: "fog"}


def test_other_poses_have_none(folder, out, caplog):
    """As those of a map that was made of them: all scans lie to each other as they say."""
    caplog.set_level(logging.INFO, "lidar_mos")
    path = out / "poses.txt"
    path.write_text(path.read_text().replace("0.5", "0.6"))
    recording = open_recording(folder, Options(poses=path, calib=out / "calib.txt"))
    assert lost(recording) == {}
    assert "is not the file of which" in caplog.text
    (out / "odometry.json").write_text("{")
    assert lost(open_recording(folder, Options(poses=path, calib=out / "calib.txt"))) == {}
