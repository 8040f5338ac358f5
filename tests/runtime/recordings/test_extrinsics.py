import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from runtime.commands.main import main
from runtime.errors import PoseError, SettingError
from runtime.recordings.extrinsics import read_extrinsics
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.paths import BUNDLE

MOUNT = np.eye(4)  # T_body_lidar
MOUNT[:3, :3] = Rotation.from_euler("xyz", [2, -3, 90], degrees=True).as_matrix()
MOUNT[:3, 3] = 0.8, 0.1, 1.7
X, Y, Z, W = Rotation.from_matrix(MOUNT[:3, :3]).as_quat()
SEVEN = f"0.8 0.1 1.7 {X} {Y} {Z} {W}"


@pytest.mark.parametrize(
    "text",
    [
        SEVEN,
        SEVEN.replace(" ", ", "),
        " ".join(f"{v:.17g}" for v in MOUNT.reshape(-1)),
        "\n".join(map(str, MOUNT[:3].reshape(-1))),
    ],
)
def test_numbers_or_a_file_of_them(tmp_path, text):
    (tmp_path / "mount.txt").write_text(f"# measured\n{text}\n")
    for given in (text, tmp_path / "mount.txt", str(tmp_path / "mount.txt")):
        np.testing.assert_allclose(read_extrinsics(given), MOUNT, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("1 2 3", SettingError, "must be 7 numbers .* not 3 numbers"),
        ("nowhere.txt", SettingError, "must be 7 numbers"),
        ("1 2 3 0 0 0 0", PoseError, "quaternion is no rotation"),
        ("2 0 0 0 0 2 0 0 0 0 2 0", PoseError, "not a rigid transform"),
    ],
)
def test_what_is_none(text, error, words):
    with pytest.raises(error, match=words):
        read_extrinsics(text)


def test_poses_of_a_body_in_a_file(folder, tmp_path):
    """The poses of the LiDAR are back; no calibration is needed."""
    drive = street.drive(6)
    street.write_poses(tmp_path / "body.txt", drive @ np.linalg.inv(MOUNT))
    (folder / "calib.txt").unlink()
    recording = open_recording(folder, Options(poses=tmp_path / "body.txt", extrinsics=SEVEN))
    np.testing.assert_allclose(recording.poses, drive, atol=1e-7)
    assert "extrinsics" in recording.poses_from
    np.testing.assert_allclose(recording.other_poses()["inverse"], MOUNT @ np.linalg.inv(drive) @ MOUNT, atol=1e-6)
    with pytest.raises(SettingError, match="leave out one of the two"):
        Options(extrinsics=SEVEN, frame="camera")


def test_mos_takes_them(folder, tmp_path, capsys):
    street.write_poses(tmp_path / "body.txt", street.drive(6) @ np.linalg.inv(MOUNT))
    arguments = [str(folder), "--poses", str(tmp_path / "body.txt"), "--bundle", str(BUNDLE), "--extrinsics"]
    assert main(["run", *arguments, SEVEN, "--out", str(tmp_path / "out")]) == 0
    assert main(["run", *arguments, "1 2"]) == 2
    assert "--extrinsics 1 2: must be" in " ".join(capsys.readouterr().err.split())
