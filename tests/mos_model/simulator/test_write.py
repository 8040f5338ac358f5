import numpy as np
import pytest

from mos_model.simulator import simulate, write_dataset
from mos_model.simulator.write import sequence_seed
from runtime.errors import OutputError, SettingError
from tests.support.disk import full_disk


def read_matrices(path):
    return [np.array(line.split(), float).reshape(3, 4) for line in path.read_text().splitlines()]


def square(matrix):
    return np.vstack([matrix, (0, 0, 0, 1)])


def test_layout_and_content(tmp_path):
    calls = []
    done = write_dataset(tmp_path / "data", 2, 2, seed=5, progress=lambda *a: calls.append(a), street="urban")
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert done.scans == 4
    folder = done.path / "sequences" / "01"
    names = sorted(str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file())
    assert names == [
        "calib.txt", "labels/000000.label", "labels/000001.label", "poses.txt", "times.txt",
        "velodyne/000000.bin", "velodyne/000001.bin",
    ]  # fmt: skip
    drive = simulate(sequence_seed(5, 1), 2, street="urban")
    for k, frame in enumerate(drive):
        points = np.fromfile(folder / f"velodyne/{k:06d}.bin", np.float32).reshape(-1, 4)
        np.testing.assert_array_equal(points, frame.points)
        np.testing.assert_array_equal(np.fromfile(folder / f"labels/{k:06d}.label", np.uint32), frame.labels)
    calibration = dict(line.split(":") for line in (folder / "calib.txt").read_text().splitlines())
    camera = square(np.array(calibration["Tr"].split(), float).reshape(3, 4))
    poses = [np.linalg.inv(camera) @ square(p) @ camera for p in read_matrices(folder / "poses.txt")]
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)
    expected = np.linalg.inv(drive.poses[0]) @ drive.poses[1]
    np.testing.assert_allclose(poses[1], expected, atol=1e-9)
    assert len((folder / "times.txt").read_text().split()) == 2


def test_an_existing_folder_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(OutputError, match="exists"):
        write_dataset(tmp_path, 1, 1)
    assert (tmp_path / "mine.txt").read_text() == "precious"


def test_a_place_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        write_dataset(tmp_path / "file" / "data", 1, 1)


def test_a_full_disk(tmp_path):
    with full_disk(100_000), pytest.raises(OutputError, match="cannot write"):
        write_dataset(tmp_path / "data", 1, 1)
    assert list(tmp_path.iterdir()) == []


def test_whole_or_not_at_all(tmp_path):
    class StopError(Exception):
        pass

    def stop(done, total):
        raise StopError

    with pytest.raises(StopError):
        write_dataset(tmp_path / "data", 1, 2, progress=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [{"sequences": 0}, {"seed": -1}, {"frames": 0}, {"street": "moon"}])
def test_bad_settings_leave_nothing(tmp_path, arguments):
    with pytest.raises(SettingError):
        write_dataset(tmp_path / "data", **arguments)
    assert list(tmp_path.iterdir()) == []
