"""`--sensor` of the commands that run a network or simulate."""

import json

import pytest

from mos_model.simulator.write import write_dataset
from runtime.commands.main import main
from tests.support.bundles import for_sensors
from tests.support.paths import BUNDLE


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A bundle for two sensors, and a drive of each of two."""
    folder = tmp_path_factory.mktemp("made")
    for name in ("hdl32e", "vlp16"):
        write_dataset(folder / name, 1, 3, seed=4, sensor=name, street="urban", sensor_variation=False)
    return for_sensors(folder, "hdl64e", "hdl32e"), folder


@pytest.fixture
def own(tmp_path):
    path = tmp_path / "own.json"
    path.write_text('{"name": "own", "elevations": [10, 5, 0, -5, -10, -15], "azimuth_steps": 300}')
    return path


def test_run_says_which_sensor_it_found(made, tmp_path, capsys):
    bundle, folder = made
    arguments = ["--bundle", str(bundle), "--postprocess", "none", "--out", str(tmp_path)]
    assert main(["run", str(folder / "vlp16/sequences/00"), *arguments]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "beams" in line]
    assert said == ["mos: about 16 beams, -15 to 15 degrees: as vlp16, by the thresholds for hdl32e"]
    assert main(["run", str(folder / "vlp16/sequences/00"), *arguments, "--sensor", "vlp16"]) == 1
    assert "sensor" in capsys.readouterr().err  # predictions of another choice are not continued
    assert main(["run", str(folder / "vlp16/sequences/00"), *arguments, "--sensor", "vlp16", "--overwrite"]) == 0
    assert "beams" not in capsys.readouterr().err
    assert json.loads((tmp_path / "sequences/00/run.json").read_text())["sensor"] == "vlp16"


def test_doctor_compares_with_the_sensor_that_a_run_would_take(made, own, capsys):
    bundle, folder = made
    recording = str(folder / "hdl32e/sequences/00")
    assert main(["doctor", recording, "--bundle", str(bundle)]) == 0
    shown = capsys.readouterr().out
    assert "about 32 beams, -31 to 11 degrees: as hdl32e" in " ".join(shown.split())
    assert "warn" not in shown
    assert main(["doctor", recording, "--bundle", str(bundle), "--sensor", str(own)]) == 0
    assert "own, as given" in " ".join(capsys.readouterr().out.split())


def test_info_lists_every_sensor(made, capsys):
    assert main(["info", str(made[0])]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "sensor hdl64e 64 x 256 pixels" in shown
    assert "sensor hdl32e 32 x 256 pixels" in shown
    assert "moving from 0.31 on" in shown


def test_simulate_takes_a_file(own, tmp_path, capsys):
    assert main(["simulate", str(tmp_path / "street"), "--frames", "1", "--sensor", str(own)]) == 0
    assert (tmp_path / "street/sequences/00/velodyne/000000.bin").stat().st_size < 6 * 300 * 16


@pytest.mark.parametrize("command", ["run", "doctor", "view", "simulate"])
def test_a_sensor_that_is_none_is_wrong_usage(command, made, own, tmp_path, capsys):
    where = [str(made[1] / "vlp16/sequences/00")] if command != "simulate" else [str(tmp_path / "street")]
    bundle = [] if command == "simulate" else ["--bundle", str(BUNDLE)]
    own.write_text('{"name": "own", "elevations": [10, 5], "azimuth_steps": 1.5}')
    for sensor, why in (("hdl65", "unknown sensor"), (str(own), "azimuth_steps: must be a whole number")):
        assert main([command, *where, *bundle, "--sensor", sensor]) == 2
        assert why in " ".join(capsys.readouterr().err.replace("│", "").split())


def test_the_carrier_is_left_out_by_numbers(made, tmp_path, capsys):
    bundle, folder = made
    arguments = ["run", str(folder / "vlp16/sequences/00"), "--bundle", str(bundle), "--out", str(tmp_path)]
    assert main([*arguments, "--nearest", "2", "--body=-1,-1,-2,3,1,0", "--postprocess", "none"]) == 0
    note = json.loads((tmp_path / "sequences/00/run.json").read_text())
    assert (note["nearest"], note["body"]) == (2.0, [-1, -1, -2, 3, 1, 0])
    capsys.readouterr()
    for body in ("1,2,3", "a,b,c,d,e,f"):
        assert main([*arguments, "--body", body]) == 2
        assert "two corners of a box" in " ".join(capsys.readouterr().err.replace("│", "").split())
