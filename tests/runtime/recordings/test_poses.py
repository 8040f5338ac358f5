import numpy as np
import pytest

from runtime.errors import MosError, PoseError
from runtime.recordings.pose_table import read_pose_table
from runtime.recordings.poses import camera_to_lidar, check_pose


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
    got = read_pose_table(write(tmp_path / "poses.txt", poses[:, :rows].reshape(5, -1))).poses
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, poses, atol=1e-11)


def test_tum_lines(tmp_path):
    axis, angle = np.array([1, 2, 3]) / np.sqrt(14), 0.7
    quaternion = [*(np.sin(angle / 2) * axis), np.cos(angle / 2)]
    got = read_pose_table(write(tmp_path / "tum.txt", [[1.5e9, 4, 5, 6, *quaternion]])).poses
    np.testing.assert_allclose(got[0], pose(angle), atol=1e-9)


def test_comments_and_empty_lines_are_skipped(tmp_path):
    path = write(tmp_path / "poses.txt", [np.eye(4)[:3].ravel()] * 2)
    path.write_text("# poses\n\n" + path.read_text() + "\n\n")
    assert read_pose_table(path).poses.shape == (2, 4, 4)


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
        read_pose_table(path)
    assert str(path) in str(error.value)
    assert isinstance(error.value, MosError)


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(PoseError, match="cannot be read"):
        read_pose_table(tmp_path / "poses.txt")
    for data in (b"\x80\x00", b"1 0\x00", b"\xff\xfe\x31"):
        (tmp_path / "poses.txt").write_bytes(data)
        with pytest.raises(PoseError, match="not a text"):
            read_pose_table(tmp_path / "poses.txt")


def test_camera_poses_become_lidar_poses_that_start_at_the_identity():
    tr = pose(1.4, (1, -1, 1), (0.1, -0.2, -0.3))
    lidar = np.stack([pose(0.2 * i, (0, 0, 1), (1e3 + i, 2 * i, 3)) for i in range(4)])
    start = pose(2.0, (3, 1, 2), (7, 8, 9))  # any world of the camera
    camera = start @ tr @ lidar @ np.linalg.inv(tr)
    got = camera_to_lidar(camera, tr)
    np.testing.assert_allclose(got, np.linalg.inv(lidar[0]) @ lidar, atol=1e-8)


ROW = np.array([0.36, 0.48, -0.8, 1.25, -0.8, 0.6, 0, 2, 0.48, 0.64, 0.6, 3])


@pytest.mark.parametrize(
    "data",
    [
        "{plain}\n{plain}\n".encode("utf-8-sig"),
        "{plain}\n{plain}\n".encode("utf-16"),  # as PowerShell's > writes it
        b"{plain}\r\n{plain}\r\n",
        b"{commas}\n{commas}\n",
        b"{trailing}\n{trailing}\n",
        b"{semicolons}\n{semicolons}",
        b"{tabs}\n{tabs}\n",
        b"{fortran}\n{fortran}\n",
        b"# x y z\n{plain}  # first\n\n% second\n{plain}\n",
        b"{plain}\n{plain}\n   \n\t\n",
    ],
)
def test_text_files_of_other_tools(tmp_path, data):
    numbers = [f"{value:.17g}" for value in ROW]
    forms = {
        "plain": " ".join(numbers),
        "commas": ",".join(numbers),
        "trailing": ", ".join(numbers) + ",",
        "semicolons": "; ".join(numbers),
        "tabs": "\t".join(numbers),
        "fortran": " ".join(f"{value:.16E}".replace("E", "D") for value in ROW),
    }
    encoding = "utf-16" if data.startswith(b"\xff\xfe") else "utf-8"
    text = data.decode(encoding)
    for name, form in forms.items():
        text = text.replace("{" + name + "}", form)
    (tmp_path / "poses.txt").write_bytes(text.encode(encoding))
    got = read_pose_table(tmp_path / "poses.txt").poses
    np.testing.assert_array_equal(got[:, :3], [ROW.reshape(3, 4)] * 2)


def test_a_broken_first_pose_spoils_no_other():
    lidar = np.stack([pose(0.2 * i, (0, 0, 1), (i, 2 * i, 3)) for i in range(4)])
    tr = pose(1.4, (1, -1, 1), (0.1, -0.2, -0.3))
    camera = tr @ lidar @ np.linalg.inv(tr)
    expected = camera_to_lidar(camera[1:], tr)
    camera[0, 1, 2] = np.nan
    np.testing.assert_allclose(camera_to_lidar(camera, tr)[1:], expected, atol=1e-9)
    with pytest.raises(PoseError, match="NaN"):
        camera_to_lidar(np.full((2, 4, 4), np.nan), tr)


def test_a_pose_rounded_in_a_file_is_rigid():
    assert check_pose(np.round(pose(), 5)).dtype == np.float64
    check_pose(pose(position=(5e6, -5e6, 100)).tolist())


def test_a_good_pose_stays_as_it_is_bit_for_bit():
    for decimals in (16, 9, 6, 5, 4):
        rounded = np.round(pose(), decimals)
        np.testing.assert_array_equal(check_pose(rounded), rounded)


def test_three_decimals_give_the_nearest_rotation():
    exact = pose(0.9, (1, -1, 2))
    for shift in np.linspace(0, 0.4, 40):
        exact = pose(0.9 + shift, (1, -1, 2))
        rounded = np.round(exact, 3)
        kept = rounded.copy()
        got = check_pose(rounded)
        np.testing.assert_array_equal(rounded, kept)
        np.testing.assert_allclose(got, exact, atol=1.5e-3)
        skew = np.abs(got[:3, :3] @ got[:3, :3].T - np.eye(3)).max()
        assert skew < (1e-12 if (got != rounded).any() else 1e-3)


@pytest.mark.parametrize("scale", [0.99, 1.002, 1.1])
def test_a_scale_is_no_rounding(scale):
    matrix = pose()
    matrix[:3, :3] *= scale
    with pytest.raises(PoseError, match="not a rigid"):
        check_pose(matrix)


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
