"""`mos view` and the pictures of `mos demo`, from files to files."""

import os
from itertools import pairwise

import numpy as np
import pytest

from mos_model.simulator.demo import run_demo
from runtime.classes import to_classes
from runtime.commands.main import main
from runtime.errors import InferenceError, SequenceError, SettingError
from runtime.pictures import write_picture
from runtime.pictures.drawing import draw
from runtime.pictures.snapshot import Snapshot
from runtime.pictures.verdict import COLOURS, FALSE_ALARM, FOUND, MISSED
from runtime.recordings.labels import read_truth, write_labels
from runtime.recordings.registry import open_recording
from tests.support import street
from tests.support.disk import full_disk
from tests.support.paths import TINY

Image = pytest.importorskip("PIL.Image")

SCANS = TINY / "scans" / "sequences" / "00"


@pytest.fixture(scope="module")
def predictions(tmp_path_factory):
    """Two systems: one finds all movers, the other is off by a hundred points."""
    root = tmp_path_factory.mktemp("predictions")
    for file in sorted((SCANS / "labels").iterdir()):
        moving = to_classes(read_truth(file)) == 2
        write_labels(root / "right" / "sequences" / "00" / "predictions" / file.name, moving)
        wrong = np.roll(moving, 100)
        write_labels(root / "wrong" / "sequences" / "00" / "predictions" / file.name, wrong)
    return root


def view(*arguments):
    return main(["view", str(SCANS), *map(str, arguments)])


def count(path, kind):
    """Pixels of a colour below the legend."""
    with Image.open(path) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)[50:]
    return int((np.abs(pixels - COLOURS[kind]).sum(2) < 12).sum())


def test_a_picture_of_a_scan(predictions, tmp_path, capsys):
    right, wrong = tmp_path / "right.png", tmp_path / "wrong.png"
    assert view("--predictions", predictions / "right", "--out", right) == 0
    assert capsys.readouterr().out.strip() == str(right)
    assert view("--predictions", predictions / "wrong" / "sequences" / "00", "--out", wrong, "--scan", 8) == 0
    assert count(right, FOUND) > 20
    assert count(right, MISSED) == count(right, FALSE_ALARM) == 0
    assert count(wrong, MISSED) > 20
    assert count(wrong, FALSE_ALARM) > 20


def test_two_systems(predictions, tmp_path):
    out = tmp_path / "two.png"
    assert view("--predictions", predictions / "right", "--compare", predictions / "wrong", "--out", out) == 0
    with Image.open(out) as image:
        width = image.width
        pixels = np.asarray(image.convert("RGB")).astype(int)[50:]
    missed = np.nonzero(np.abs(pixels - COLOURS[MISSED]).sum(2) < 12)[1]
    assert len(missed) > 20
    assert missed.min() > width / 2


def test_what_the_bundle_says_now_is_what_it_writes(tmp_path):
    bundle = ["--bundle", str(TINY / "bundle"), "--threads", "1"]
    assert main(["run", str(SCANS), "--out", str(tmp_path / "tiny"), *bundle]) == 0
    assert view("--predictions", tmp_path / "tiny", "--out", tmp_path / "stored.png") == 0
    assert view(*bundle, "--out", tmp_path / "live.png") == 0
    assert (tmp_path / "live.png").read_bytes() == (tmp_path / "stored.png").read_bytes()


def test_a_count_of_scans_is_not_for_one_picture(tmp_path):
    with pytest.raises(SettingError, match=r"a.png: a .png shows one scan, so that `count` has no meaning"):
        draw(open_recording(SCANS), tmp_path / "a.png", count=5)


def test_a_gif_has_every_scan(predictions, tmp_path):
    out = tmp_path / "all.gif"
    assert view("--predictions", predictions / "right", "--out", out, "--scan", 2, "--count", 4) == 0
    with Image.open(out) as image:
        assert image.n_frames == 4
        pages = []
        for page in range(4):
            image.seek(page)
            pages.append(np.asarray(image.convert("RGB"))[50:])
            assert image.info["duration"] == (100 if page < 3 else 1000)
    for before, after in pairwise(pages):
        assert (before != after).any(2).mean() > 0.01
    assert all((np.abs(page.astype(int) - COLOURS[FOUND]).sum(2) < 12).any() for page in pages)


def test_a_recording_has_scans_labels_and_poses(predictions, tmp_path):
    chunk = pytest.importorskip("rerun.chunk")
    out = tmp_path / "all.rrd"
    assert view("--predictions", predictions / "right", "--out", out, "--scan", 3, "--count", 2) == 0
    entities: dict[str, set[int]] = {}
    for part in chunk.RrdReader(out).stream().to_chunks():
        times = part.to_record_batch().column("scan").to_pylist() if "scan" in part.timeline_names else []
        entities.setdefault(part.entity_path, set()).update(times)
    for name in ("/world/path", "/world/lidar", "/world/lidar/right", "/world/lidar/labels"):
        assert entities[name] == {3, 4}


def test_an_error_of_the_network_is_not_taken_for_one_of_the_file(tmp_path):
    recording = pytest.importorskip("runtime.pictures.rerun_file")

    def failing():
        raise InferenceError("the image network failed")
        yield

    with pytest.raises(InferenceError, match="the image network failed"):
        recording.record(tmp_path / "a.rrd", failing())
    assert list(tmp_path.iterdir()) == []


def test_what_takes_no_part_is_not_drawn_as_moving(tmp_path, predictions, monkeypatch, capsys):
    """As in `mos run`: within a box around all there is, nothing moves."""
    monkeypatch.setenv("COLUMNS", "200")
    out, box = tmp_path / "a.png", "-999,-999,-999,999,999,999"
    for options, drawn in (((), True), (("--body", box), False)):
        assert view("--bundle", TINY / "bundle", "--out", out, *options) == 0
        with Image.open(out) as image:
            pixels = np.asarray(image.convert("RGB")).astype(int)[50:]
        found = [(np.abs(pixels - COLOURS[kind]).sum(2) < 12).any() for kind in (FOUND, FALSE_ALARM)]
        assert any(found) == drawn
    assert view("--predictions", predictions / "right", "--out", out, "--body", box) == 2
    assert "--nearest and --body are for what a bundle says now" in capsys.readouterr().err


def test_a_viewer_is_shown_each_scan_as_soon_as_it_is_there(tmp_path):
    recording = pytest.importorskip("runtime.pictures.rerun_file")
    rerun, chunk = pytest.importorskip("rerun"), pytest.importorskip("rerun.chunk")
    viewer = rerun.RecordingStream("viewer")
    seen = rerun.binary_stream(viewer)

    def scans_in(data):
        (tmp_path / "seen.rrd").write_bytes(data)
        parts = chunk.RrdReader(tmp_path / "seen.rrd").stream().to_chunks()
        times = [part.to_record_batch().column("scan").to_pylist() for part in parts if "scan" in part.timeline_names]
        return {one for some in times for one in some}

    def played():
        for index in range(3):
            points = np.ones((5, 3), np.float32) * index
            yield Snapshot("07", index, f"{index}", points, np.eye(4), None, {"mine": np.zeros(5, bool)})
            assert index in scans_in(seen.read())

    assert recording.record(tmp_path / "a.rrd", played(), [viewer]) == 3
    assert scans_in((tmp_path / "a.rrd").read_bytes()) == {0, 1, 2}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scan", "9"], "no scan 9: sequence 00 has the scans 0 to 8"),
        (["--out", "a.bmp"], ".png"),
        (["--predictions", "absent"], "absent"),
    ],
)
def test_errors_are_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert view(*arguments) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("mos: ")]
    assert len(lines) == 1
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_several_sequences(tmp_path, capsys):
    for name in ("01", "02"):
        street.write_kitti(tmp_path / "sequences" / name, 2, rows=4, columns=20)
    assert main(["view", str(tmp_path), "--out", str(tmp_path / "a.png")]) == 1
    assert "01, 02; name one (--sequence)" in capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".png", ".gif", ".rrd"])
def test_a_place_that_cannot_be_written(predictions, tmp_path, capsys, suffix):
    (tmp_path / "file").write_text("")
    out = tmp_path / "file" / f"a{suffix}"
    count = [] if suffix == ".png" else ["--count", 1]
    assert view("--predictions", predictions / "right", "--out", out, *count) == 1
    assert f"cannot write {out}" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("suffix", [".png", ".gif", ".rrd"])
def test_a_full_disk(predictions, tmp_path, capsys, suffix):
    """Nothing is moved into place that was cut off, wherever that was: of every size, down to the last byte."""
    if suffix == ".rrd":
        pytest.importorskip("rerun")
    out = tmp_path / f"a{suffix}"
    arguments = ("--predictions", predictions / "right", "--out", out, "--scan", 3)
    arguments += () if suffix == ".png" else ("--count", 2)
    assert view(*arguments) == 0
    size = out.stat().st_size
    out.write_text("older")
    for room in (1, size // 2, size - 1000):
        with full_disk(room):
            assert view(*arguments) == 1
        assert f"mos: cannot write {out}: File too large" in capsys.readouterr().err
        assert os.listdir(tmp_path) == [out.name]
        assert out.read_text() == "older"


def test_no_scan_no_picture(tmp_path):
    with pytest.raises(SequenceError, match="no scan"):
        write_picture(tmp_path / "a.png", [])
    assert list(tmp_path.iterdir()) == []


def test_the_demo_draws_a_scan_and_the_street(tmp_path):
    done = run_demo(tmp_path / "demo", 3, TINY / "bundle", 2)
    assert [path.name for path in done.pictures] == ["scan.png", "street.gif"]
    assert done.no_pictures == ""
    with Image.open(done.pictures[0]) as still, Image.open(done.pictures[1]) as moving:
        assert still.size == moving.size
    assert count(done.pictures[0], FOUND) + count(done.pictures[0], MISSED) > 0
