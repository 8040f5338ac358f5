"""`mos run`."""

import inspect
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import fields

import pytest

from runtime.commands.handler import command
from runtime.commands.main import main
from runtime.commands.run import run
from runtime.commands.runner_options import provider
from runtime.runner import MosRunner
from runtime.settings import LONGEST_DELAY, RunnerSettings
from tests.support import street
from tests.support.paths import BUNDLE, ROOT

WIDE = {**os.environ, "COLUMNS": "200", "PYTHONPATH": str(ROOT)}


def labels(out, name="07"):
    return sorted(path.name for path in (out / "sequences" / name / "predictions").glob("*.label"))


def test_run(folder, tmp_path, capsys):
    assert main(["run", str(folder), "--out", str(tmp_path), "--bundle", str(BUNDLE), "--threads", "1"]) == 0
    assert labels(tmp_path) == [f"{i:06d}.label" for i in range(10)]
    shown = capsys.readouterr()
    assert "sequence 07: 10 scans" in shown.out
    assert re.search(r"[\d,]+ points, .* % moving", shown.out)
    assert re.search(r"scan +[\d.]+ +[\d.]+", shown.out)
    assert str(tmp_path / "sequences" / "07" / "predictions") in shown.out
    assert "scans/s" in shown.err

    again = ["run", str(folder.parent), "--out", str(tmp_path), "--bundle", str(BUNDLE), "--sequence", "07"]
    assert main(again) == 0
    assert "0 scans, 10 were there already" in capsys.readouterr().out


def test_run_says_so_where_the_labels_will_be_wrong(folder, tmp_path, capsys):
    arguments = ["--bundle", str(BUNDLE), "--pose-frame", "lidar", "--postprocess", "none", "--out", str(tmp_path)]
    assert main(["run", str(folder), *arguments]) == 0
    said = capsys.readouterr().err
    assert re.search(r"mos: .*07: alignment: .*The labels will be wrong", said), said


def test_what_the_doctor_has_said_the_runner_does_not_repeat(tmp_path, capsys):
    folder = street.write_kitti(tmp_path / "sequences" / "08", 14, columns=240)
    arguments = ["--bundle", str(BUNDLE), "--pose-frame", "lidar", "--postprocess", "none", "--out", str(tmp_path)]
    assert main(["run", str(folder), *arguments]) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "alignment" in line]
    assert len(told) == 1
    assert told[0].endswith("The labels will be wrong")


def test_run_of_the_first_scans_with_lidar_poses(folder, tmp_path, capsys):
    arguments = ["--bundle", str(BUNDLE), "--limit", "2", "--pose-frame", "lidar", "--postprocess", "knn"]
    assert main(["run", str(folder), "--out", str(tmp_path), *arguments]) == 0
    assert labels(tmp_path) == ["000000.label", "000001.label"]


def test_every_setting_of_the_runner_has_an_option():
    options = {option.name: option.opts for option in command("run", run).params}
    settings = {field.name for field in fields(RunnerSettings)} | inspect.signature(MosRunner).parameters.keys()
    settings -= {"settings", "changes"}  # the same as a whole, or by name
    options["deskew"] = options.pop("no_deskew")
    assert settings <= options.keys()
    for name in settings:
        spelled = {"providers": "--provider", "session_options": "--session-option", "deskew": "--no-deskew"}.get(name)
        assert options[name] == [spelled or f"--{name.replace('_', '-')}"]


def test_the_longest_delay_is_all(folder, tmp_path, capsys):
    arguments = ["run", str(folder), "--bundle", str(BUNDLE), "--postprocess", "none"]
    for delay in ("all", str(LONGEST_DELAY)):
        assert main([*arguments, "--delay", delay, "--out", str(tmp_path / delay)]) == 0
    all_of_them, longest = (
        [path.read_bytes() for path in sorted((tmp_path / delay).rglob("*.label"))]
        for delay in ("all", str(LONGEST_DELAY))
    )
    assert len(all_of_them) == 10
    assert all_of_them == longest


@pytest.mark.parametrize("wrong", ["-1", "51", "1.5", "most", ""])
def test_no_other_delay(wrong, folder, tmp_path, capsys):
    assert main(["run", str(folder), "--out", str(tmp_path), f"--delay={wrong}"]) == 2
    assert "neither a number of scans, 0 to 50, nor all" in " ".join(capsys.readouterr().err.replace("│", " ").split())


def test_settings_reach_the_runner(folder, tmp_path, capsys):
    arguments = ["run", str(folder), "--bundle", str(BUNDLE), "--limit", "1", "--overwrite", "--out", str(tmp_path)]
    settings = ["--postprocess", "head", "--refine", "all", "--head-engine", "numba", "--precision", "float32"]
    sessions = ["--provider", "CPUExecutionProvider", "--session-option", "session.intra_op.allow_spinning=0"]
    assert main([*arguments, *settings, *sessions]) == 0
    note = json.loads((tmp_path / "sequences" / "07" / "run.json").read_text())
    assert (note["postprocess"], note["refine"], note["precision"]) == ("head", "all", "float32")
    capsys.readouterr()
    for refused, why in (
        (["--head-engine", "onnx", "--session-option", "session.load_model_format=ORT"], "ONNX Runtime"),
        (["--precision", "int8"], "int8"),
        (["--provider", "CPUExecutionProvider", "--provider", "AbsentProvider"], "(--allow-fallback)"),
    ):
        assert main([*arguments, *refused]) == 1
        said = capsys.readouterr().err.splitlines()[-1]
        assert said.startswith("mos: ")
        assert why in said
    assert main([*arguments, "--provider", "AbsentProvider", "--allow-fallback"]) == 0
    assert "AbsentProvider is not in the installed ONNX Runtime" in capsys.readouterr().err


def test_providers_and_their_options():
    assert provider("CPUExecutionProvider") == "CPUExecutionProvider"
    wanted = ("CUDAExecutionProvider", {"device_id": "0", "path": "/a=b:c"})
    assert provider("CUDAExecutionProvider:device_id=0,path=/a=b:c") == wanted


def test_poses_are_for_one_sequence(folder, tmp_path, capsys):
    street.write_kitti(tmp_path / "sequences" / "01", 2, rows=4, columns=20)
    street.write_kitti(tmp_path / "sequences" / "02", 2, rows=4, columns=20)
    for name in ("run", "doctor"):
        assert main([name, str(tmp_path), "--poses", str(folder / "poses.txt")]) == 2
        assert "name one (--sequence)" in capsys.readouterr().err


def test_all_sequences_of_a_root(tmp_path, capsys):
    for name in ("01", "02"):
        street.write_kitti(tmp_path / "sequences" / name, 2, rows=8, columns=60)
    assert main(["run", str(tmp_path), "--out", str(tmp_path / "out"), "--bundle", str(BUNDLE)]) == 0
    for name in ("01", "02"):
        assert labels(tmp_path / "out", name) == ["000000.label", "000001.label"]


def test_warnings_are_lines_too(tmp_path, capsys):
    folder = street.write_kitti(tmp_path / "03", 4, rows=8, columns=60)
    (folder / "velodyne" / "000000.bin").unlink()
    assert main(["run", str(folder), "--out", str(tmp_path), "--bundle", str(BUNDLE)]) == 0
    assert "mos: warning: " in capsys.readouterr().err


@pytest.mark.parametrize("cause", [KeyboardInterrupt(), ValueError()])
def test_an_interrupt_inside_of_numba(folder, tmp_path, capsys, monkeypatch, cause):
    """Numba turns what is raised while it hands over a result into a SystemError."""

    def interrupted(*arguments, **options):
        raise SystemError("returned a result with an exception set") from cause

    monkeypatch.setattr("runtime.fleet.labelling.predict", interrupted)
    arguments = ["run", str(folder), "--out", str(tmp_path), "--bundle", str(BUNDLE)]
    if isinstance(cause, KeyboardInterrupt):
        assert main(arguments) == 130
        assert "goes on from there" in capsys.readouterr().err
    else:
        with pytest.raises(SystemError):
            main(arguments)


def test_an_interrupt_keeps_what_is_finished(tmp_path):
    folder = street.write_kitti(tmp_path / "05", 12, rows=16, columns=120)
    many = tmp_path / "many"
    many.mkdir()
    for i in range(3000):
        os.link(folder / "velodyne" / f"{i % 12:06d}.bin", many / f"{i}.bin")
    street.write_poses(many / "poses.txt", street.drive(3000))
    out = tmp_path / "out"
    command = [
        sys.executable,
        "-m",
        "runtime.commands.start",
        "run",
        str(many),
        "--pose-frame",
        "lidar",
        "--out",
        str(out),
    ]
    process = subprocess.Popen(
        [*command, "--bundle", str(BUNDLE), "--threads", "1"],
        stderr=subprocess.PIPE,
        text=True,
        env=WIDE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background job would ignore it
    )
    deadline = time.monotonic() + 300
    while process.poll() is None and time.monotonic() < deadline:
        if out.exists() and len(labels(out, "many")) > 2:
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    assert 2 < len(labels(out, "many")) < 3000
    assert not list(out.rglob("*.part"))
