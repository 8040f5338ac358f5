"""The sensor of a runner: given, the bundle's, or found in the first scan."""

import logging
import warnings

import numpy as np
import pytest

from mos_model.simulator import simulate
from runtime import MosRunner
from runtime.errors import SettingError
from runtime.predict import predict
from runtime.recordings.registry import open_recording
from runtime.sensors.registry import SENSORS
from tests.support.bundles import for_sensors
from tests.support.paths import BUNDLE, TINY


def drive(name, count=3, seed=4):
    settings = {"street": "urban", "sensor_variation": False}
    return [(frame.points, frame.pose) for frame in simulate(seed, count, name, **settings)]


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    return for_sensors(tmp_path_factory.mktemp("many"), "hdl64e", "hdl32e")


@pytest.fixture(scope="module")
def runner(many):
    with MosRunner(many, threads=2) as made:
        yield made


@pytest.mark.parametrize("name", ["hdl64e", "hdl32e", "vlp16"])
def test_the_first_scan_decides_as_if_it_were_given(many, runner, name, caplog):
    runner.reset()
    assert runner.sensor is None
    scans = drive(name)
    with caplog.at_level(logging.INFO, "lidar_mos.sensors"), warnings.catch_warnings():
        warnings.simplefilter("error")
        found = [runner(*scan) for scan in scans]
    assert [result.sensor for result in found] == [name] * 3
    (told,) = caplog.messages
    assert f"as {name}" in told
    assert ("by the thresholds for hdl32e" in told) == (name == "vlp16")
    with MosRunner(many, threads=2, sensor=name) as given:
        assert given.sensor.name == name
        for one, other in zip(found, [given(*scan) for scan in scans], strict=True):
            np.testing.assert_array_equal(one.probability, other.probability)
            np.testing.assert_array_equal(one.moving, other.moving)


def test_what_was_found_stays_until_reset(runner):
    runner.reset()
    assert runner(*drive("hdl32e", 1)[0]).sensor == "hdl32e"
    assert runner(*drive("vlp16", 1)[0]).sensor == "hdl32e"
    runner.reset(keep_sensor=True)
    assert runner(*drive("vlp16", 1)[0]).sensor == "hdl32e"
    runner.reset()
    assert runner(*drive("vlp16", 1)[0]).sensor == "vlp16"


def test_scans_that_show_nothing_do_not_decide(runner):
    runner.reset()
    empty = np.empty((0, 4), np.float32)
    assert runner(empty, np.eye(4)).sensor == "hdl64e"  # the first of the bundle
    assert runner.sensor is None
    assert runner(*drive("hdl32e", 1)[0]).sensor == "hdl32e"


def test_a_call_that_fails_decides_nothing(runner):
    runner.reset()
    points, _ = drive("hdl32e", 1)[0]
    with pytest.raises(ValueError, match="pose"):
        runner(points, np.zeros((4, 4)))
    assert runner.sensor is None


def test_the_frame_of_a_vehicle_changes_no_label(runner):
    tilt = np.radians(5)
    frame = np.eye(4)
    frame[0, [0, 2]] = frame[2, [2, 0]] = np.cos(tilt), np.sin(tilt)
    frame[2, 0] *= -1
    frame[:3, 3] = 1.2, 0, 0.8
    runner.reset()
    scans = drive("hdl32e")
    want = [runner(*scan) for scan in scans]
    runner.reset()
    for (points, pose), expected in zip(scans, want, strict=True):
        moved = points.copy()
        moved[:, :3] = points[:, :3].astype(np.float64) @ frame[:3, :3].T + frame[:3, 3]
        result = runner(moved, pose @ np.linalg.inv(frame))
        assert result.sensor == "hdl32e"
        assert np.mean(np.abs(result.probability - expected.probability) < 0.05) > 0.9


def test_a_bundle_for_one_sensor_is_run_for_that():
    with MosRunner(BUNDLE, threads=1) as one:
        assert one.sensor.name == "hdl64e"
        assert one(*drive("vlp16", 1)[0]).sensor == "hdl64e"
    with MosRunner(BUNDLE, threads=1, sensor="vlp16") as other:
        result = other(*drive("vlp16", 1)[0])
        assert (result.sensor, other.sensor.range_image) == ("vlp16", SENSORS["vlp16"].range_image)


def test_a_sensor_of_ones_own_from_a_file(tmp_path, runner):
    path = tmp_path / "own.json"
    path.write_text('{"name": "own", "elevations": [9, 6, 3, 0, -3, -6, -9, -12], "azimuth_steps": 900}')
    with MosRunner(runner.bundle.path, threads=1, sensor=path) as own:
        assert (own.sensor.name, own.sensor.range_image.height, own.sensor.range_image.width) == ("own", 16, 896)
    for text, why in (
        ('{"name": "own"}', "has no elevations, azimuth_steps"),
        ('{"name": "own", "elevations": [1, 2], "azimuth_steps": 900}', "must fall"),
        ('{"name": "own", "elevations": ["1"], "azimuth_steps": 900}', r"elevations\[0\]: must be a number"),
        ("{", "is no JSON"),
    ):
        path.write_text(text)
        with pytest.raises(SettingError, match=why):
            MosRunner(runner.bundle.path, sensor=str(path))
    with pytest.raises(SettingError, match="unknown sensor 'hdl65'"):
        MosRunner(runner.bundle.path, sensor="hdl65")


def test_a_run_that_goes_on_takes_the_same_sensor(many, tmp_path):
    """The first scan of the recording decides, not the first that is labelled."""
    recording = open_recording(TINY / "scans/sequences/00")
    with MosRunner(many, threads=1) as made:
        whole = predict(recording, made, tmp_path).folder
        want = {path.name: path.read_bytes() for path in whole.glob("*.label")}
        sensor = made.sensor
        (whole / "000007.label").unlink()
        assert predict(recording, made, tmp_path).scans == 1
        assert made.sensor == sensor
        assert {path.name: path.read_bytes() for path in whole.glob("*.label")} == want


def test_the_carrier_takes_no_part(many):
    points, pose = drive("hdl32e", 1)[0]
    x, y, z = points[:, :3].T
    near = np.linalg.norm(points[:, :3], axis=1) < 6
    inside = (np.abs(x - 8) < 2) & (np.abs(y) < 3) & (np.abs(z) < 3)
    assert near.any()
    assert (inside & ~near).any()
    with MosRunner(many, threads=2, sensor="hdl32e", nearest=6.0, body=(10, -3, 3, 6, 3, -3)) as made:
        result = made(points, pose)
    assert (result.probability[near | inside] == 0).all()
    assert not result.moving[near | inside].any()
    assert (result.probability[~(near | inside)] > 0).mean() > 0.99
    for wrong in ({"nearest": -1.0}, {"nearest": np.inf}, {"body": (1, 2, 3)}, {"body": (0, 0, 0, 1, 1, np.nan)}):
        with pytest.raises(SettingError):
            MosRunner(many, **wrong)
