import numpy as np
import pytest

from runtime.errors import MosError, PoseError
from runtime.recordings.poses import camera_to_lidar, check_pose, read_calib, read_poses


def rotation(axis, angle):
    """Rotation matrix by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def pose(angle=0.3, axis=(1, 2, 3), position=(4, 5, 6)):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(axis, angle), position
    return matrix


def write(path, rows):
    path.write_text("\n".join(" ".join(f"{value:.12e}" for value in row) for row in rows) + "\n")
    return path


@pytest.mark.parametrize("rows", [3, 4])
def test_twelve_and_sixteen_numbers_a_line(tmp_path, rows):
    poses = np.stack([pose(0.1 * i, position=(i, 2 * i, -i)) for i in range(5)])
    got = read_poses(write(tmp_path / "poses.txt", poses[:, :rows].reshape(5, -1)))
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, poses, atol=1e-11)


def test_tum_lines(tmp_path):
    axis, angle = np.array([1, 2, 3]) / np.sqrt(14), 0.7
    quaternion = [*(np.sin(angle / 2) * axis), np.cos(angle / 2)]
    got = read_poses(write(tmp_path / "tum.txt", [[1.5e9, 4, 5, 6, *quaternion]]))
    np.testing.assert_allclose(got[0], pose(angle), atol=1e-9)


def test_comments_and_empty_lines_are_skipped(tmp_path):
    path = write(tmp_path / "poses.txt", [np.eye(4)[:3].ravel()] * 2)
    path.write_text("# poses\n\n" + path.read_text() + "\n\n")
    assert read_poses(path).shape == (2, 4, 4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses"),
        ("1 2 3\n", "line 1 has 3 numbers"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1\n", "line 2 has 11 numbers, not 12 like"),
        ("1 0 0 0 0 1 0 0 0 0 1 x\n", "line 1 is not made of numbers"),
    ],
)
def test_broken_files_are_named_with_their_line(tmp_path, text, message):
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(PoseError, match=message) as error:
        read_poses(path)
    assert str(path) in str(error.value)
    assert isinstance(error.value, MosError)


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(PoseError, match="cannot be read"):
        read_poses(tmp_path / "poses.txt")
    (tmp_path / "poses.txt").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(PoseError, match="not a text"):
        read_poses(tmp_path / "poses.txt")


def test_calib_gives_tr(tmp_path):
    tr = pose(1.5)
    numbers = " ".join(f"{value:.12e}" for value in tr[:3].ravel())
    (tmp_path / "calib.txt").write_text(f"P0: {' '.join(['1'] * 12)}\nTr: {numbers}\n")
    np.testing.assert_allclose(read_calib(tmp_path / "calib.txt"), tr, atol=1e-11)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("P0: 1 2 3\n", "no line 'Tr:'"),
        ("Tr: 1 2 3\n", "3 numbers, not 12"),
        ("Tr: a b c\n", "not made of numbers"),
        ("Tr: " + "2 " * 12 + "\n", "not a rigid transform"),
    ],
)
def test_broken_calib(tmp_path, text, message):
    (tmp_path / "calib.txt").write_text(text)
    with pytest.raises(PoseError, match=message):
        read_calib(tmp_path / "calib.txt")


def test_camera_poses_become_lidar_poses_that_start_at_the_identity():
    tr = pose(1.4, (1, -1, 1), (0.1, -0.2, -0.3))
    lidar = np.stack([pose(0.2 * i, (0, 0, 1), (1e3 + i, 2 * i, 3)) for i in range(4)])
    start = pose(2.0, (3, 1, 2), (7, 8, 9))  # any world of the camera
    camera = start @ tr @ lidar @ np.linalg.inv(tr)
    got = camera_to_lidar(camera, tr)
    np.testing.assert_allclose(got, np.linalg.inv(lidar[0]) @ lidar, atol=1e-8)


def test_a_pose_rounded_in_a_file_is_rigid():
    assert check_pose(np.round(pose(), 5)).dtype == np.float64
    check_pose(pose(position=(5e6, -5e6, 100)).tolist())


def mirrored():
    matrix = pose()
    matrix[:3, 0] *= -1
    return matrix


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3), "shape"),
        (np.full((4, 4), np.nan), "NaN or infinity"),
        (pose(position=(np.inf, 0, 0)), "NaN or infinity"),
        (pose().T, "last row"),
        (np.diag([2.0, 2, 2, 1]), "not a rigid"),
        (np.diag([1e200, 1, 1, 1]), "not a rigid"),
        (mirrored(), "not a rigid"),
        ("pose", "matrix of numbers"),
    ],
)
def test_check_pose_refuses(matrix, message):
    with pytest.raises(PoseError, match=message) as error:
        check_pose(matrix, "poses.txt: pose 7")
    assert str(error.value).startswith("poses.txt: pose 7:")
