"""The command `mos export`, which is the script too."""

import os
import subprocess
import sys

import pytest

from export import to_onnx
from runtime.bundle.loading import load_bundle
from runtime.commands.handler import run_alone
from runtime.errors import CheckpointError
from tests.support.paths import ROOT, TINY


def test_no_checkpoint_is_an_error_on_the_command_line(tmp_path, capsys):
    (tmp_path / "x.pt").write_text("not a checkpoint")
    assert (
        run_alone(
            to_onnx.export, "mos export", ["--checkpoint", str(tmp_path / "x.pt"), "--out", str(tmp_path / "bundle")]
        )
        == 1
    )
    assert "mos: " in capsys.readouterr().err
    assert not (tmp_path / "bundle").exists()


def test_the_script_exports_from_a_checkout(tmp_path):
    """Another size, float32; as a script, whose folder then stands first on the path."""
    out = tmp_path / "bundle"
    command = [sys.executable, "-W", "error", ROOT / "export" / "to_onnx.py", "--checkpoint", TINY / "checkpoint.pt"]
    command += ["--out", out, "--height", "32", "--width", "128", "--weights", "float32", "--threads", "1"]
    command += ["--point-head-onnx"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "parity   image network" in done.stdout
    assert ", as ONNX graph" in done.stdout
    assert "not trained" in done.stdout
    manifest = load_bundle(out).manifest
    assert (manifest.sensor.range_image.height, manifest.sensor.range_image.width) == (32, 128)
    assert {entry.precision for entry in manifest.files.values()} == {"float32"}


def test_without_arguments_it_takes_the_default_or_the_tiny_checkpoint(monkeypatch, tmp_path):
    monkeypatch.setattr(to_onnx, "ROOT", tmp_path)
    with pytest.raises(CheckpointError, match="give one by --checkpoint"):
        to_onnx.default_checkpoint()
    for place, out in (("tests/data/tiny", "models/tiny"), ("models/rt", "models/rt")):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "checkpoint.pt").write_bytes(b"")
        assert to_onnx.default_checkpoint() == (tmp_path / place / "checkpoint.pt", tmp_path / out)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--height", "0"],
        ["--height", "-16"],
        ["--height", "63"],
        ["--width", "0"],
        ["--width", "2047"],
        ["--threads", "0"],
        ["--precision", "float32", "--calibration", "x"],
    ],
)
def test_what_would_be_ignored_or_cannot_be_is_wrong_usage(arguments, tmp_path, capsys):
    """No number is taken for "as in the checkpoint"."""
    command = ["--checkpoint", str(TINY / "checkpoint.pt"), "--out", str(tmp_path / "bundle")]
    assert run_alone(to_onnx.export, "mos export", command + arguments) == 2
    assert "Error" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_errors_speak_of_options(tmp_path, capsys):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_bytes(b"cat")
    command = ["--checkpoint", str(TINY / "checkpoint.pt"), "--out", str(tmp_path / "photos")]
    assert run_alone(to_onnx.export, "mos export", command) == 1
    assert "choose another folder (--out)" in capsys.readouterr().err
