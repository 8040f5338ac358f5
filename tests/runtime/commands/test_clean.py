"""`mos clean`, and `mos run --write`."""

import numpy as np
import pytest

from runtime.commands.main import main
from runtime.recordings.formats.registry import read_cloud
from tests.support import street
from tests.support.paths import BUNDLE


@pytest.fixture
def folder(tmp_path):
    return street.write_kitti(tmp_path / "07", 4, rows=16, columns=240)


def test_clean(folder, tmp_path, capsys):
    arguments = ["clean", str(folder), "--bundle", str(BUNDLE), "--threads", "1", "--out", str(tmp_path / "out")]
    for _ in range(2):  # labels are made once; the rest is written anew
        assert main([*arguments, "--delay", "0", "--voxel", "0.3"]) == 0
    shown = capsys.readouterr().out
    assert "0 scans, 4 were there already" in shown
    out = tmp_path / "out" / "sequences" / "07"
    assert {path.name for path in out.iterdir()} >= {"clean", "map.ply", "predictions"}
    assert f"static map: {out / 'map.ply'}, " in shown
    assert f"without what moves: {out / 'clean'}, 4 scans, " in shown
    assert len(list((out / "clean" / "velodyne").glob("*.bin"))) == 4


def test_run_writes_clouds_with_labels(folder, tmp_path, capsys):
    arguments = ["run", str(folder), "--bundle", str(BUNDLE), "--threads", "1", "--out", str(tmp_path / "out")]
    assert main([*arguments, "--write", "cloud", "--format", "pcd"]) == 0
    clouds = tmp_path / "out" / "sequences" / "07" / "clouds"
    for index in range(4):
        scan = np.fromfile(folder / "velodyne" / f"{index:06d}.bin", "<f4").reshape(-1, 4)
        np.testing.assert_array_equal(read_cloud(clouds / f"{index:06d}.pcd").data, scan)
    (clouds / "000002.pcd").unlink()
    capsys.readouterr()
    assert main([*arguments, "--write", "cloud", "--format", "pcd"]) == 0
    assert "sequence 07: 1 scans, 3 were there already" in capsys.readouterr().out
    assert (clouds / "000002.pcd").is_file()


def test_options_that_would_be_ignored_are_wrong(folder, capsys):
    for options in (["--format", "ply"], ["--voxel", "0.2"], ["--write", "map", "--format", "ply"]):
        assert main(["run", str(folder), *options]) == 2
        assert "add --write" in capsys.readouterr().err
