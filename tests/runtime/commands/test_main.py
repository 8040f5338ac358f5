import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from runtime.commands.main import main
from tests.support import street
from tests.support.paths import ROOT

BUNDLE = ROOT / "tests" / "data" / "tiny" / "bundle"
WIDE = {**os.environ, "COLUMNS": "200", "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return street.write_kitti(tmp_path_factory.mktemp("kitti") / "sequences" / "07", 10, rows=16, columns=120)


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


def labels(out, name="07"):
    return sorted(path.name for path in (out / "sequences" / name / "predictions").glob("*.label"))


def test_importing_the_command_is_quick():
    """`mos --help` imports every command, and nothing that computes."""
    heavy = {"numpy", "numba", "onnxruntime", "scipy", "torch", "onnx", "rich.progress"}
    code = f"import sys; from runtime.commands.main import main; main(['--help']); print({heavy!r} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=WIDE, check=True)
    assert done.stdout.splitlines()[-1] == "set()"


def test_the_installed_package_is_found_from_any_folder(tmp_path):
    code = "import importlib.metadata as m; m.version('lidar-mos')"
    if subprocess.run([sys.executable, "-I", "-c", code], capture_output=True).returncode:
        pytest.skip("lidar-mos is not installed in this environment")
    code = "from runtime.commands.main import main; main(['--version'])"
    done = subprocess.run([sys.executable, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_help_and_version(capsys):
    assert main(["--help"]) == 0
    assert "doctor" in capsys.readouterr().out
    assert main(["run", "--help"]) == 0
    assert "--pose-frame" in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert re.match(r"lidar-mos \d+\.\d+", capsys.readouterr().out)


@pytest.mark.parametrize(
    "arguments",
    [
        ["walk"],
        ["run"],
        ["run", ".", "--threads", "0"],
        ["run", ".", "--limit", "0"],
        ["run", ".", "--pose-frame", "world"],
        ["run", ".", "--postprocess", "best"],
        ["run", ".", "--frobnicate"],
    ],
)
def test_wrong_usage_is_2(arguments, capsys):
    assert main(arguments) == 2
    assert capsys.readouterr().err


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


def test_run_of_the_first_scans_with_lidar_poses(folder, tmp_path, capsys):
    arguments = ["--bundle", str(BUNDLE), "--limit", "2", "--pose-frame", "lidar", "--postprocess", "knn"]
    assert main(["run", str(folder), "--out", str(tmp_path), *arguments]) == 0
    assert labels(tmp_path) == ["000000.label", "000001.label"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "absent"], "does not exist"),
        (["run", "{folder}", "--poses", "absent.txt"], "absent.txt does not exist"),
        (["run", "{folder}", "--calib", "absent.txt"], "absent.txt does not exist"),
        (["run", "{folder}", "--bundle", "absent"], "absent"),
        (["info", "absent"], "absent"),
        (["doctor", "absent"], "does not exist"),
        (["doctor", "{folder}", "--bundle", "absent"], "absent"),
    ],
)
def test_errors_are_one_line_without_a_traceback(folder, tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main([argument.format(folder=folder) for argument in arguments]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("mos: ")
    assert shown.err.count("\n") == 1
    assert message in shown.err


def test_poses_are_for_one_sequence(folder, tmp_path, capsys):
    street.write_kitti(tmp_path / "sequences" / "01", 2, rows=4, columns=20)
    street.write_kitti(tmp_path / "sequences" / "02", 2, rows=4, columns=20)
    assert main(["run", str(tmp_path), "--poses", str(folder / "poses.txt")]) == 1
    assert "name one (`names`)" in capsys.readouterr().err


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


def test_info_tells_nested_and_absent_values(capsys):
    from runtime.bundle.head_shape import LITE
    from runtime.bundle.loading import Bundle
    from runtime.bundle.manifest import FileEntry, Manifest, SensorEntry
    from runtime.bundle.residual import Residual
    from runtime.commands.info import show_bundle
    from runtime.sensors.range_image import RangeImage

    manifest = Manifest(
        name="x",
        network="dual",
        sensors=(SensorEntry("hdl64e", RangeImage()),),
        residual=Residual(),
        features=32,
        point_head=LITE,
        files={"image_net.onnx": FileEntry("0" * 64, 2_500_000, "float32")},
        weights={"trained": True},
        model={"network": "dual", "sensor": {}},
        parity={"head": {"max_abs": 1.25e-7}, "floats": []},
    )
    show_bundle(Bundle(Path("x"), manifest))
    shown = capsys.readouterr().out
    for text in (
        "64 x 2048",
        "down 64 128",
        "2.50 MB",
        "head max abs 1.25e-07",
        "floats none",
        "trained yes",
        "not measured",
    ):
        assert text in shown


def test_info(capsys):
    assert main(["info", str(BUNDLE)]) == 0
    shown = capsys.readouterr().out
    for word in ("network", "sensor", "image_net.onnx", "weights", "licence", "MIT"):
        assert word in shown


def test_doctor(folder, tmp_path, capsys):
    assert main(["doctor", str(folder), "--bundle", str(BUNDLE)]) in (0, 1)
    assert main(["doctor", str(folder), "--bundle", str(BUNDLE), "--pose-frame", "lidar"]) == 1
    shown = capsys.readouterr().out
    assert "use --pose-frame camera" in " ".join(shown.split())
    assert re.search(r"^bad +alignment", shown, re.MULTILINE)


@pytest.mark.parametrize("cause", [KeyboardInterrupt(), ValueError()])
def test_an_interrupt_inside_of_numba(folder, tmp_path, capsys, monkeypatch, cause):
    """Numba turns what is raised while it hands over a result into a SystemError."""

    def interrupted(*arguments):
        raise SystemError("returned a result with an exception set") from cause

    monkeypatch.setattr("runtime.commands.run.predict_with_progress", interrupted)
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
        "runtime.commands.main",
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
