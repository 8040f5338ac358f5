"""A recording in pieces, beside the same as a whole."""

import json
import shutil
import warnings
from functools import partial

import numpy as np
import pytest

from runtime.bundle.manifest import MANIFEST
from runtime.fleet.events import Done, Said, Scans
from runtime.fleet.here import label_here
from runtime.fleet.processes import label_in_processes
from runtime.fleet.wanted import Wanted
from runtime.fleet.work import settle
from runtime.recordings.recording import Options
from runtime.recordings.registry import open_recording
from runtime.runner import MosRunner
from runtime.settings import RunnerSettings
from tests.runtime.fleet.conftest import COUNT, labels
from tests.support import street
from tests.support.bundles import for_sensors

WAYS = {"alone": {"belief": "none"}, "belief": {"belief": "online"}, "delay": {"delay": 3}}


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """The first two scans are empty, and show no sensor; remission goes up to 255 in the third alone."""
    folder = street.write_kitti(tmp_path_factory.mktemp("drive") / "05", COUNT, rows=16, columns=180, fov=(15.0, -15.0))
    for index in range(COUNT):
        path = folder / "velodyne" / f"{index:06d}.bin"
        scan = np.fromfile(path, np.float32).reshape(-1, 4)
        scan[:, 3] *= 255 if index == 2 else 1
        (scan[:0] if index < 2 else scan).tofile(path)
    return folder


@pytest.fixture(scope="module")
def bundle(drive, tmp_path_factory):
    """For two sensors: a scan decides on which. Its thresholds are passed by half of the points, else all would be."""
    folder = for_sensors(tmp_path_factory.mktemp("bundle"), "vlp16", "hdl32e")
    names = {"alone": "threshold", "belief": "belief_threshold", "delay": "delayed_threshold"}
    decision = {names[way]: half_way(folder, drive, **settings) for way, settings in WAYS.items()}
    manifest = json.loads((folder / MANIFEST).read_text())
    for sensor in manifest["sensors"]:
        sensor["decision"] |= decision | {"head_threshold": decision["threshold"]}
    (folder / MANIFEST).write_text(json.dumps(manifest))
    return folder


def half_way(bundle, drive, **settings):
    """The median probability."""
    with warnings.catch_warnings(), MosRunner(bundle, threads=1, **settings) as runner:
        warnings.simplefilter("ignore")
        results = [runner(scan) for scan in open_recording(drive)]
        found = [one.probability for one in [*results, *runner.flush()] if one]
    return float(np.median(np.concatenate(found)))


def run(bundle, drive, out, piece=None, wanted=Wanted(), way=label_here, options=Options(), **settings):  # noqa: B008
    """All that is heard, and what became of the recording."""
    work = settle(bundle, RunnerSettings(threads=1, **settings), options, out, False, wanted, piece)
    heard = []
    way(work, [drive], hear=heard.append)
    (done,) = (one for one in heard if isinstance(one, Done))
    return heard, done


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("settings", WAYS.values(), ids=WAYS)
def test_pieces_of_any_length_have_the_bytes_of_the_whole(bundle, drive, tmp_path, settings):
    _, plain = run(bundle, drive, tmp_path / "whole", **settings)
    assert plain.error == ""
    whole = labels(tmp_path / "whole")
    assert 0.2 < plain.moving / plain.points < 0.8
    for piece in (4, 17, COUNT):
        out = tmp_path / str(piece)
        heard, done = run(bundle, drive, out, piece, **settings)
        assert labels(out) == whole, piece
        assert (done.error, done.scans, done.points) == ("", COUNT, plain.points)
        assert done.moving == plain.moving
        assert [one.done for one in heard if isinstance(one, Scans)][-1] == COUNT
        said = [one for one in heard if isinstance(one, Said)]
        assert len(set(said)) == len(said)
        beside = out / "sequences" / "05"
        if piece < COUNT:
            settled = json.loads((beside / "run.json").read_text())["settled"]
            assert (settled["sensor"], settled["shown_by"], settled["remission_scale"]) == ("vlp16", 2, 255.0)
        entries = [(path / "sequences/05/scans.jsonl").read_text().splitlines() for path in (out, tmp_path / "whole")]
        assert sorted(entries[0]) == sorted(entries[1])  # so that any run goes on from there
        assert sorted(path.name for path in beside.iterdir()) == ["predictions", "run.json", "scans.jsonl"]
        assert run(bundle, drive, out, **settings)[1].resumed == COUNT


@pytest.mark.filterwarnings("ignore")
def test_interrupted_it_goes_on_in_other_pieces(bundle, drive, tmp_path):
    run(bundle, drive, tmp_path / "whole")
    whole, out = labels(tmp_path / "whole"), tmp_path / "out"

    def stop(event):
        if isinstance(event, Scans) and event.done == 17:
            raise KeyboardInterrupt

    work = settle(bundle, RunnerSettings(threads=1), Options(), out, False, Wanted(), 5)
    with pytest.raises(KeyboardInterrupt):
        label_here(work, [drive], hear=stop)
    assert list((out / "sequences/05").glob("scans.*.jsonl"))
    assert labels(out).items() < whole.items()
    (out / "sequences/05/predictions/.000001.label.0123abcd.part").write_bytes(b"left by one that was killed")
    done = run(bundle, drive, out, 8)[1]
    assert (done.resumed, done.scans) == (17, COUNT - 17)
    assert labels(out) == whole
    assert not [path for path in out.rglob(".*")]


@pytest.mark.filterwarnings("ignore")
def test_a_piece_that_is_not_warmed_up_would_have_other_bytes(bundle, drive, tmp_path, monkeypatch):
    """Else the tests above saw nothing."""
    run(bundle, drive, tmp_path / "whole")
    monkeypatch.setattr("runtime.runner.MosRunner.history_length", 1)
    run(bundle, drive, tmp_path / "out", 7)
    assert labels(tmp_path / "out") != labels(tmp_path / "whole")


@pytest.mark.filterwarnings("ignore")
def test_broken_scans(bundle, drive, tmp_path):
    """Each is left out as in the whole, whoever comes upon it; else its piece ends there, and is named."""
    broken = shutil.copytree(drive, tmp_path / "05")
    for index in (9, 10, 30):
        path = broken / "velodyne" / f"{index:06d}.bin"
        path.write_bytes(path.read_bytes()[:-5])
    done = run(bundle, broken, tmp_path / "stopped", 12, belief="online")[1]
    assert done.error.startswith("stopped at scan 000009 (10 of 40)")
    assert len(labels(tmp_path / "stopped")) == 9  # all other pieces come upon a broken one, before or within them
    skipping = Options(skip_broken=True)
    for settings in WAYS.values():
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        shutil.rmtree(tmp_path / "whole", ignore_errors=True)
        run(bundle, broken, tmp_path / "whole", options=skipping, **settings)
        heard, done = run(bundle, broken, tmp_path / "out", 6, options=skipping, **settings)
        assert (done.error, done.scans) == ("", COUNT - 3)
        assert labels(tmp_path / "out") == labels(tmp_path / "whole")
        notes = [json.loads((tmp_path / one / "sequences/05/run.json").read_text()) for one in ("out", "whole")]
        assert notes[0]["broken"] == notes[1]["broken"]
        assert len([one for one in heard if isinstance(one, Said) and "broken scans, left without" in one.text]) == 1


@pytest.mark.filterwarnings("ignore")
def test_side_by_side_with_poses_that_are_found(bundle, drive, tmp_path):
    """Found once, before the pieces; and what is made of all labels is made once, after them."""
    pytest.importorskip("kiss_icp", reason="needs the extra 'odometry'")
    bare = shutil.copytree(drive, tmp_path / "05")
    (bare / "poses.txt").unlink()
    for index in (0, 1):  # KISS-ICP begins with points
        shutil.copy(bare / "velodyne" / "000002.bin", bare / "velodyne" / f"{index:06d}.bin")
    options, wanted = Options(given_poses="optional"), Wanted(map=True, cloud=True)
    run(bundle, bare, tmp_path / "whole", wanted=wanted, options=options)
    way = partial(label_in_processes, jobs=2)
    _, done = run(bundle, bare, tmp_path / "out", 13, wanted=wanted, options=options, way=way)
    assert (done.error, done.scans) == ("", COUNT)
    whole, pieces = (everything(tmp_path / one / "sequences/05") for one in ("whole", "out"))
    assert {name.split("_")[0] for name in whole} >= {"map", "poses.txt", "predictions/000039.label"}
    assert pieces == whole


def everything(folder):
    """The files but for notes, which name the folder."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in ("run.json", "scans.jsonl")]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
