import logging

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.errors import SettingError
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.recordings.remission import find_scale
from tests.support import street
from tests.support.paths import BUNDLE


def scans_with(values):
    points = np.zeros((len(values), 4), np.float32)
    points[:, 3] = values
    return [points]


RANDOM = np.random.default_rng(3)


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        (RANDOM.random(5000), 1),
        (np.append(RANDOM.random(5000), 4000), 1),  # one wild value
        (np.append(RANDOM.random(5000), [np.nan, np.inf]), 1),
        (RANDOM.integers(0, 256, 5000), 255),
        (np.append(RANDOM.integers(0, 256, 5000), 300), 255),
        (RANDOM.integers(0, 101, 5000), 255),  # 8 bits, no number plate in sight
        (RANDOM.integers(0, 2, 5000), 1),
        (np.append(RANDOM.integers(0, 2, 9000), [7, 90]), 255),  # whole numbers of a dark scene
        (RANDOM.random(5000) * 255, 255),
        (RANDOM.integers(0, 3000, 5000), 4095),
        (RANDOM.integers(0, 65536, 5000), 65535),
        (RANDOM.random(5000) * 1e6, 65535),  # the doctor says that it does not fit
        (np.append(RANDOM.integers(0, 256, 5000), -1), 255),
        (RANDOM.normal(0, 30, 5000), 1),  # is none at all
        (np.zeros(5000), 1),
        ([], 1),
    ],
)
def test_the_scale_that_remission_shows(values, scale):
    assert find_scale(scans_with(values))[1] == scale


def test_no_remission_has_no_scale():
    assert find_scale([np.zeros((5, 3), np.float32)]) == (0, 1)
    assert find_scale([]) == (0, 1)


@pytest.fixture
def drive(tmp_path):
    """A sequence with remission in 8 bits; the first scan cannot be read."""
    folder = street.write_kitti(tmp_path / "05", 6, rows=64, columns=180)
    for path in (folder / "velodyne").iterdir():
        points = np.fromfile(path, np.float32).reshape(-1, 4)
        points[:, 3] = np.round(255 * points[:, 3])
        points.tofile(path)
    (folder / "velodyne" / "000000.bin").write_bytes(bytes(15))
    return folder


def test_it_is_scaled_and_said_once(drive, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    recording = open_recording(drive)
    assert set(np.unique(np.concatenate([recording.read(i).remission for i in range(1, 6)]))) == {
        np.float32(51) / np.float32(255),
        np.float32(102) / np.float32(255),
    }
    (record,) = caplog.records
    assert "05: remission goes up to 102 and is divided by 255" in record.getMessage()


def test_a_given_scale_is_taken_without_a_word(drive, caplog):
    caplog.set_level(logging.INFO, "lidar_mos")
    assert open_recording(drive, Options(remission_scale=102)).read(1).remission.max() == 1
    assert caplog.records == []
    for scale in (0, -1, float("nan"), float("inf")):
        with pytest.raises(SettingError, match="above 0"):
            Options(remission_scale=scale)


def test_mos_says_it_and_takes_the_option(drive, tmp_path, capsys):
    arguments = ["run", str(drive), "--out", str(tmp_path / "out"), "--bundle", str(BUNDLE), "--skip-broken"]
    assert main(arguments) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "divided by" in line]
    assert len(said) == 1
    assert said[0].startswith("mos: ")
    assert said[0].endswith("divided by 255; if that is wrong, give its full scale (--remission-scale)")
    assert main([*arguments, "--remission-scale", "255"]) == 0
    shown = capsys.readouterr()
    assert "0 scans, 6 were there already" in shown.out
    assert "divided by" not in shown.err
    assert main([*arguments, "--remission-scale", "0"]) == 2
