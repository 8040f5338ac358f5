"""The accuracy benchmark on a drive made by hand, with and without the other tool."""

import importlib.util
import json
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from bench import accuracy
from bench.accuracy import Scan, score, shipped, with_peer, with_runner
from bench.peers import DUFOMAP, STREAMING, peers, versions
from tests.support import street
from tests.support.paths import BUNDLE


def drive(count=11):
    world = street.boxes()
    for i, pose in enumerate(street.drive(count)):
        points = street.scan(pose, world, rows=16, columns=120)
        yield Scan(points, pose, np.where(np.arange(len(points)) % 3, 1, 2), i >= 8)


def test_every_system_sees_every_scan_and_starts_anew():
    seen = []

    def system(share):
        def label(scans):
            seen.append((share, len(scans)))
            return (np.arange(len(scan.points)) % 3 < share for scan in scans)

        return label

    found = score([drive, drive], {"all": system(3), "right": system(1)})
    assert seen == [(3, 11), (1, 11)] * 2
    assert found["right"].iou == found["all"].recall == 1
    assert found["all"].precision == pytest.approx(1 / 3, abs=0.01)


def test_a_runner_sees_every_scan_once_in_order_and_starts_anew():
    class Runner:
        def reset(self):
            self.past = []

        def remember(self, points, pose):
            self.past.append(pose)

        def __call__(self, points, pose):
            np.testing.assert_array_equal(self.past, street.drive(11)[: len(self.past)])
            assert len(self.past) >= 8
            self.past.append(pose)
            return SimpleNamespace(moving=np.arange(len(points)) % 3 == 0)

    assert score([drive, drive], {"": with_runner(Runner())})[""].iou == 1


def test_results_that_come_later_are_those_of_their_own_scans():
    class Runner:
        def reset(self):
            self.waiting = []

        def __call__(self, points, pose):
            self.waiting.append(SimpleNamespace(moving=np.arange(len(points)) % 3 == 0))
            return self.waiting.pop(0) if len(self.waiting) > 2 else None

        def flush(self):
            return self.waiting

    assert score([drive, drive], {"": with_runner(Runner(), delay=True)})[""].iou == 1


def test_the_shipped_bundles_are_found():
    assert "rt" in [bundle.name for bundle in shipped()]


def test_a_peer_that_is_not_installed_is_left_out_with_the_reason(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    found, left_out = peers()
    assert found == {}
    assert left_out == {name: f"not installed: pip install {name}" for name in (STREAMING, DUFOMAP)}
    assert versions() == {}


def test_a_peer_gets_points_of_the_world_and_tells_what_moves(monkeypatch):
    calls = []

    class Filter:
        def __init__(self, **settings):
            calls.clear()

        def filter(self, points, origin):
            calls.append((points, origin))
            return points[1:], np.arange(len(points)) > 0

    tool = SimpleNamespace(RangeImageGhostFilter=Filter)
    monkeypatch.setitem(sys.modules, "dynamic_object_removal", tool)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: tool)
    found, _ = peers()
    pose = np.array([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]])
    scan = np.array([[np.nan, 0, 0, 0], [1, 0, 0, 0], [2, 0, 1, 0]], np.float32)
    (moving,) = with_peer(found[STREAMING])([Scan(scan, pose, np.ones(3), True)])
    np.testing.assert_array_equal(moving, [False, True, False])
    np.testing.assert_array_equal(calls[0][0], [[5, 7, 7], [5, 8, 8]])
    np.testing.assert_array_equal(calls[0][1], [5, 6, 7])


def test_dufomap_sees_all_scans_first_and_no_point_at_the_origin(monkeypatch):
    seen = []

    class Tool:
        def __init__(self, *settings, num_threads):
            assert num_threads == 3

        def run(self, points, pose):
            assert points.shape[1] == 3
            assert np.linalg.norm(points, axis=1).min() > 0  # NaN fails, too
            seen.append(pose[0, 3])

        def segment(self, points, pose):
            assert seen == [0, 1]
            return (points[:, 0] > 3).astype(np.uint8)

    tool = SimpleNamespace(dufomap=Tool)
    monkeypatch.setitem(sys.modules, "dufomap", tool)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: tool if name == "dufomap" else None)
    scan = np.array([[0, 0, 0, 0], [5, 0, 0, 0], [np.nan, 0, 0, 0], [2, 0, 0, 0], [9, 0, 1, 0]], np.float32)
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 1
    found, left_out = peers(threads=3)
    assert list(left_out) == [STREAMING]
    for moving in with_peer(found[DUFOMAP])([Scan(scan, pose, np.ones(5), True) for pose in poses]):
        np.testing.assert_array_equal(moving, [False, True, False, False, True])


def test_dufomap_itself_finds_what_drives_by():
    pytest.importorskip("dufomap")
    box = np.stack(np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 12), np.linspace(-1, 0, 9), [0]), -1)
    car, scans = box.reshape(-1, 4).astype(np.float32), []
    for t, pose in enumerate(street.drive(5)):
        points = street.scan(pose, street.boxes(), rows=32, columns=360)
        points[0] = 0
        points = np.concatenate([points, car + np.float32([6 + 1.5 * t, 0, 0, 0])])
        scans.append(Scan(points, pose, np.ones(len(points)), True))
    first, *_ = with_peer(peers()[0][DUFOMAP])(scans)
    assert first[-len(car) :].mean() > 0.5
    assert first[: -len(car)].mean() < 0.05
    assert not first[0]


def test_streets_are_those_of_the_sensor_of_the_bundles(tmp_path, monkeypatch):
    other = shutil.copytree(BUNDLE, tmp_path / "other")
    manifest = json.loads((other / "manifest.json").read_text())
    manifest["sensors"][0]["name"] = "vlp16"
    (other / "manifest.json").write_text(json.dumps(manifest))
    asked = []

    def simulate(seed, frames, sensor, **settings):
        asked.append(sensor)
        return []

    monkeypatch.setattr(accuracy, "simulate", simulate)
    monkeypatch.setattr(accuracy, "peers", lambda threads: ({}, {}))
    accuracy.bench([other], streets=1, frames=1, quiet=1, threads=1)
    assert asked == ["vlp16", "vlp16"]
    with pytest.raises(typer.BadParameter, match="vlp16"):
        accuracy.bench([other, BUNDLE], streets=1, frames=1, quiet=1, threads=1)


def test_the_file_keeps_its_keys(tmp_path, monkeypatch):
    monkeypatch.setattr(accuracy, "simulated", lambda *a, **k: [drive])
    monkeypatch.setattr(accuracy, "peers", lambda threads: ({}, {"other": "not here"}))
    monkeypatch.setattr(
        accuracy, "residual_threshold", lambda _: lambda scans: (np.zeros(len(scan.points), bool) for scan in scans)
    )
    file = tmp_path / "accuracy.json"
    accuracy.bench([BUNDLE], streets=1, frames=3, quiet=10, threads=1, out=file)
    found = json.loads(file.read_text())
    settings = {"sensor", "streets", "frames", "quiet", "precision"}
    assert set(found) == {"machine", "percent", "left_out", "peers"} | settings
    assert found["left_out"] == {"other": "not here"}
    assert set(found["percent"]) == {"residual threshold, untrained", "bundle, none", "bundle, knn", "bundle, head"}
    columns = ["simulated iou", "simulated precision", "simulated recall", "quiet streets false alarms"]
    assert list(found["percent"]["bundle, knn"]) == columns
    assert found["percent"]["residual threshold, untrained"]["simulated iou"] == 0
    assert found["percent"]["residual threshold, untrained"]["simulated precision"] is None
