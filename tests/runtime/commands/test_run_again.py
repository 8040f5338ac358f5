"""`mos run` on recordings that are incomplete, broken in places, or repaired since."""

import shutil

import numpy as np
import pytest

from runtime.commands.main import main
from tests.support import street
from tests.support.paths import BUNDLE

COUNT = 6


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return street.write_kitti(tmp_path_factory.mktemp("kitti") / "07", COUNT, rows=64, columns=180)


@pytest.fixture
def folder(made, tmp_path):
    return shutil.copytree(made, tmp_path / "07")


@pytest.fixture
def run(folder, tmp_path, capsys):
    """`mos run` of the folder with these options: what it says on stdout and stderr but for the bars, and for thinning:
    the sensor of these scans is as sparse as a voxel filter leaves points."""

    def call(*options):
        done = main(["run", str(folder), "--out", str(tmp_path / "out"), "--bundle", str(BUNDLE), *options])
        shown = capsys.readouterr()
        said = [line for line in shown.err.splitlines() if line.startswith("mos:") and ": thinning: " not in line]
        return done, shown.out, said

    return call


def change(folder, factor):
    for path in (folder / "velodyne").iterdir():
        scan = np.fromfile(path, np.float32).reshape(-1, 4)
        scan[:, 3] *= factor
        scan.tofile(path)


def test_remission_repaired_in_place(folder, run):
    change(folder, -1)
    done, out, said = run()
    change(folder, -1)
    done, out, said = run()
    assert (done, said) == (0, [])
    assert f"{COUNT} scans, {COUNT} of them anew" in out
    assert f"0 scans, {COUNT} were there already" in run()[1]


def test_five_poses_are_enough_for_five_scans(folder, run):
    poses = folder / "poses.txt"
    poses.write_text("".join(poses.read_text().splitlines(keepends=True)[:5]))
    done, out, said = run("--limit", "5")
    assert (done, said) == (0, [])
    assert "5 scans" in out
    done, _, (problem,) = run()
    assert done == 1
    assert "5 poses for 6 scans" in problem


def test_a_broken_scan_is_skipped_on_request(folder, run, tmp_path):
    path = folder / "velodyne" / "000002.bin"
    path.write_bytes(path.read_bytes()[:-3])
    done, _, said = run()
    assert done == 1
    assert "stopped at scan 000002" in said[-1]
    for scans in (3, 0):
        done, out, said = run("--skip-broken")
        assert done == 0
        assert f"{scans} scans" in out
        (closing,) = [line for line in said if "left without a label" in line]
        assert "label: 1: 000002" in closing
        assert not any("will be wrong" in line for line in said)
    predictions = tmp_path / "out" / "sequences" / "07" / "predictions"
    assert [file.stem for file in sorted(predictions.iterdir())] == [f"{i:06d}" for i in (0, 1, 3, 4, 5)]


def test_many_broken_scans_are_a_line(folder, run):
    for path in (folder / "velodyne").iterdir():
        path.write_bytes(path.read_bytes()[:-3])
    done, _, said = run("--skip-broken")
    assert done == 0
    assert "label: 6: 000000" in said[-1]
    assert "and 3 more" in said[-1]
    assert len(said) < 4
