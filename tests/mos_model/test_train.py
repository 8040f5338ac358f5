"""`mos train` from the command line to the checkpoint, and what it refuses."""

import json

import numpy as np
import pytest
import torch
import typer
from typer.testing import CliRunner

from mos_model import train
from mos_model.networks import checkpoint
from mos_model.networks.registry import read_config
from runtime.commands.handler import run_alone
from runtime.errors import CheckpointError, SequenceError, SettingError
from runtime.sensors.registry import find_sensor
from tests.support.training import write_recording

VIEW = ["--set", "model.range_image.fov_up=16", "--set", "model.range_image.fov_down=-16"]
TINY = ["--channels", "4", "--set", "model.range_image.height=16", "--set", "model.range_image.width=64", *VIEW]
SHORT = [
    "--recipe",
    "sim2real",
    "--batch",
    "2",
    "--workers",
    "0",
    "--set",
    "mix=2",
    "--set",
    "weight_samples=4",
]


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Threads cost more than they bring to networks of this size."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def run(*arguments: object) -> None:
    """Run `mos train` and let its errors through."""
    app = typer.Typer()
    app.command()(train.train)
    done = CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output


@pytest.fixture
def root(tmp_path):
    write_recording(tmp_path / "data" / "sequences" / "00", frames=10)
    write_recording(tmp_path / "data" / "sequences" / "08", frames=6, seed=1)
    return tmp_path / "data"


def base(root, out, *more):
    return ["--data", root, "--train-on", "00", "--validate-on", "08", "--out", out, *TINY, *SHORT, *more]


def test_both_stages_on_recordings(root, tmp_path):
    out = tmp_path / "image"
    run(*base(root, out, "--config", "v2-lite", "--steps", 3, "--crop", 32))
    first = checkpoint.load(out / "best.pt")
    assert first.config == read_config(first.config.to_dict())
    assert (first.config.channels, first.config.point_head, first.config.range_image.height) == (4, None, 16)
    assert first.training["config"]["crop"] == 32
    assert first.training["data"] == {
        "root": str(root),
        "train": ["00"],
        "validation": ["08"],
    }
    second = tmp_path / "head"
    stage2 = ["--config", "v2-lite", "--stage", 2, "--steps", 2, "--batch", 1, "--crop", 0]
    run(*base(root, second, *stage2, "--init", out / "best.pt"))
    assert checkpoint.load(second / "last.pt").point_head is not None
    run(*base(root, second, *stage2, "--resume", "--set", "validate_every=1"))
    started = second / "last.pt"
    again = ["--steps", 1, "--set", "learning_rate=1e-12", "--init", out / "best.pt", "--init-head", started]
    run(*base(root, tmp_path / "again", *stage2, *again))
    heads = [checkpoint.load(one).point_head.state_dict() for one in (started, tmp_path / "again" / "last.pt")]
    assert all(np.allclose(heads[0][key], heads[1][key], atol=1e-6) for key in heads[0] if key.endswith("weight"))


@pytest.mark.parametrize(
    ("config", "view", "crop"),
    [("limoseg", {"bird.cells": 64}, 16), ("cylinder3d", {"cylinder.sectors": 120, "cylinder.rings": 40}, 32)],
)
def test_a_crop_of_the_recipe_is_a_quarter_of_a_narrow_view(root, tmp_path, config, view, crop):
    of_view = [part for name, value in view.items() for part in ("--set", f"model.{name}={value}")]
    run(*base(root, tmp_path, "--config", config, *of_view, "--steps", 1))
    assert checkpoint.load(tmp_path / "last.pt").training["config"]["crop"] == crop


def test_simulated_streets(tmp_path):
    small = ["--sensor", "vlp16", "--set", "street_frames=2", "--set", "validation_streets=1"]
    small += ["--set", "validation_frames=1", "--set", "crops=1"]
    run(
        "--out",
        tmp_path,
        *small,
        "--channels",
        4,
        "--config",
        "rt",
        "--set",
        "model.rt_widths=[4,8]",
        *SHORT,
        "--crop",
        32,
        "--steps",
        2,
    )
    saved = checkpoint.load(tmp_path / "last.pt")
    assert (saved.config.sensor, saved.config.range_image) == ("vlp16", find_sensor("vlp16").range_image)
    assert saved.training["step"] == 2
    kinds = [json.loads(line)["kind"] for line in (tmp_path / "metrics.jsonl").read_text().splitlines()]
    assert kinds == ["train", "validation"]


def test_resume_goes_on_and_refuses_other_settings(root, tmp_path):
    out = tmp_path / "run"
    arguments = base(root, out, "--config", "rt", "--set", "model.rt_widths=[4,8]")
    run(*arguments, "--steps", 2)
    run(*arguments, "--steps", 4, "--resume")
    assert checkpoint.load(out / "last.pt").training["step"] == 4
    with pytest.raises(CheckpointError, match="batch: 2 against 3"):
        run(*arguments, "--steps", 4, "--resume", "--batch", 3)
    with pytest.raises(CheckpointError, match="channels: 4 against 6"):
        run(*arguments, "--steps", 4, "--resume", "--channels", 6)
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        run(*base(root, tmp_path / "other"), "--resume")


def test_a_start_from_another_network_is_refused(root, tmp_path):
    run(*base(root, tmp_path / "a", "--config", "rt", "--set", "model.rt_widths=[4,8]", "--steps", 1))
    with pytest.raises(CheckpointError, match=r"of another network.*kind: 'rt' against 'lmnet'"):
        run(*base(root, tmp_path / "b", "--config", "lmnet", "--init", tmp_path / "a" / "last.pt"))


def test_second_stage_needs_a_first(root, tmp_path):
    with pytest.raises(SettingError, match=r"\(`init`\)"):
        run(*base(root, tmp_path / "b", "--config", "v2-lite", "--stage", 2, "--crop", 0))


def test_a_data_set_that_is_not_complete_is_refused_before_anything_is_written(root, tmp_path):
    with pytest.raises(SequenceError, match=r"has no sequence 01, 02, .*, 10; there are 00, 08"):
        run("--data", root, "--out", tmp_path / "run", *TINY, *SHORT)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["00", "08"])
def test_a_data_set_without_movers_is_refused(name, root, tmp_path):
    for file in (root / "sequences" / name / "labels").iterdir():
        np.full(file.stat().st_size // 4, 40, np.uint32).tofile(file)
    with pytest.raises(SequenceError, match=rf"sequences \({name}\): no point of .* is labelled as moving"):
        run(*base(root, tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_what_is_trained_and_validated_on_is_looked_at_once(root, tmp_path):
    (root / "sequences" / "00" / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 10)
    with pytest.raises(SequenceError, match="1 problem"):
        run(*base(root, tmp_path / "run"), "--validate-on", "00")


def test_what_the_doctor_calls_bad_is_refused(root, tmp_path):
    (root / "sequences" / "00" / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 10)
    with pytest.raises(SequenceError, match="sequences/00: alignment: "):
        run(*base(root, tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_published_split():
    train_names, validation = train.choose_split(True, None, None)
    assert {"00", "40"} <= set(train_names)
    assert {"08", "41"} <= set(validation)
    assert train.choose_split(False, "03,04", "") == (("03", "04"), ())


def test_settings():
    assert train.parse_setting("augmentation.yaw=20") == ("augmentation.yaw", 20)
    assert train.parse_setting("schedule=cosine") == ("schedule", "cosine")
    with pytest.raises(typer.BadParameter, match="name=value"):
        train.parse_setting("steps")
    with pytest.raises(SettingError, match="unknown entry colour"):
        run("--set", "model.colour=1")
    with pytest.raises(typer.BadParameter, match="no group"):
        train.set_nested({"depth": 3}, ["depth", "x"], 1)
    model = {"sensor": "vlp16", "range_image": {"width": 1024}}
    train.set_nested(model, ["sensor", "width"], 64)  # what the range image was called
    assert model == {"sensor": "vlp16", "range_image": {"width": 64}}


@pytest.mark.parametrize(
    "arguments",
    [
        ["--road"],
        ["--train-on", "00"],
        ["--validate-on", "08"],
        ["--pose-frame", "lidar"],
        ["--data", "{root}", "--road", "--train-on", "00", "--validate-on", "08"],
        ["--data", "{root}", "--train-on", ""],
        ["--data", "{root}", "--train-on", "00,,01"],
        ["--resume", "--init", "last.pt"],
        ["--init-head", "last.pt"],
        ["--set", "steps"],
        ["--steps", "0"],
        ["--batch", "0"],
        ["--channels", "0"],
        ["--stage", "3"],
        ["--log-every", "0"],
        ["--workers", "-1"],
        ["--minutes", "-1"],
    ],
)
def test_what_would_be_ignored_or_cannot_be_is_wrong_usage(arguments, root, tmp_path, capsys):
    out = tmp_path / "run"
    assert run_alone(train.train, "mos train", ["--out", str(out), *(one.format(root=root) for one in arguments)]) == 2
    assert "Error" in capsys.readouterr().err
    assert not out.exists()


def test_errors_name_no_options_of_other_commands(root, tmp_path, capsys):
    (root / "sequences" / "00" / "poses.txt").unlink()
    assert run_alone(train.train, "mos train", [str(one) for one in base(root, tmp_path / "run")]) == 1
    said = capsys.readouterr().err.partition("mos: ")[2]
    assert "poses.txt" in said
    assert "--" not in said
    assert "`" not in said


def test_errors_speak_of_options(root, tmp_path, capsys):
    arguments = [str(one) for one in base(root, tmp_path / "b", "--config", "v2-lite", "--stage", 2, "--crop", 0)]
    assert run_alone(train.train, "mos train", arguments) == 1
    assert "give its checkpoint (--init)" in capsys.readouterr().err


@pytest.mark.parametrize("profile", ["hdl32e", "vlp16", "os1-32", "os1-64", "os1-128"])
def test_every_beam_has_a_row_of_its_own(profile):
    beams = find_sensor(profile)
    sensor = beams.range_image
    rows = {
        int((1 - (e - sensor.fov_down) / (sensor.fov_up - sensor.fov_down)) * sensor.height) for e in beams.elevations
    }
    assert rows == set(range(beams.beams))
