"""Own scans for the calibration: taken, or refused with the reason."""

import dataclasses

import numpy as np
import pytest

from export.int8.scenes import CALIBRATION_STREETS, recorded, simulated
from mos_model.data.dataset import SampleConfig
from mos_model.simulator.write import write_dataset
from runtime.errors import MosWarning, SequenceError
from runtime.sensors.range_image import RangeImage
from runtime.sensors.registry import SENSORS


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """Ten scans of a street."""
    folder = tmp_path_factory.mktemp("street")
    write_dataset(folder, 1, 10, seed=3, sensor=dataclasses.replace(SENSORS["hdl64e"], azimuth_steps=600))
    return folder / "sequences" / "00"


def test_own_scans_calibrate(street):
    images = recorded(street, SampleConfig(range_image=RangeImage(width=256)), count=2)
    assert [image.shape for image in images] == [(1, 13, 64, 256)] * 2
    assert all(image[:, :5].any() and image[:, 5:].any() for image in images)
    assert not np.array_equal(*images)


def spoilt(street, folder, change):
    """A copy of the street whose scans went through `change`."""
    (folder / "velodyne").mkdir(parents=True)
    for name in ("calib.txt", "poses.txt"):
        (folder / name).write_bytes((street / name).read_bytes())
    for scan in sorted((street / "velodyne").iterdir()):
        points = np.fromfile(scan, np.float32).reshape(-1, 4)
        change(points).astype(np.float32).tofile(folder / "velodyne" / scan.name)
    return folder


def tilted(points):
    """Seen by a sensor that looks up: no elevation fits."""
    points[:, 2] = np.abs(points[:, 2]) + np.hypot(points[:, 0], points[:, 1])
    return points


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (np.zeros_like, "no scan holds usable points"),
        (lambda points: points * np.float32([1000, 1000, 1000, 1]), "metres"),
        (tilted, "field of view"),
        (lambda points: points * np.float32([1, 1, 1, -255]), "remission"),
    ],
)
def test_calibration_data_that_do_not_fit_are_refused(street, tmp_path, change, message):
    with pytest.raises(SequenceError, match=message):
        recorded(spoilt(street, tmp_path / "bad", change), SampleConfig())


def test_other_rows_are_warned_of(street, tmp_path):
    with pytest.warns(MosWarning, match="rows"):
        recorded(street, SampleConfig(range_image=RangeImage(height=128, width=256)), count=1)


def test_no_or_too_few_scans_are_an_error(street, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(SequenceError, match="no"):
        recorded(tmp_path / "empty", SampleConfig())
    short = spoilt(street, tmp_path / "short", lambda points: points)
    for scan in sorted((short / "velodyne").iterdir())[8:]:
        scan.unlink()
    with pytest.raises(SequenceError, match="at least 9"):
        recorded(short, SampleConfig())


def test_scenes_of_a_network_for_several_sensors_have_several_sizes():
    scenes = simulated(SampleConfig(other_sensors=("vlp16",)), CALIBRATION_STREETS, 4)
    assert len({scene.image.shape for scene in scenes}) > 1
    assert len(simulated(SampleConfig(sensor="vlp16"), CALIBRATION_STREETS, 1)) == 2
