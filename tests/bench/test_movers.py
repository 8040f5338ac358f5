"""Movers are counted by kind and distance."""

import json

import numpy as np

from bench.accuracy import STREETS
from bench.movers import Counts, Scan, bench
from tests.support.paths import BUNDLE


def test_kinds_and_distances():
    points = np.zeros((6, 4), np.float32)
    points[:, 0] = 5, 15, 15, 25, 25, 60
    labels = np.array([252, 252, 254, 254, 10, 252], np.uint32)
    counts = Counts()
    counts.add(Scan(points, np.eye(4), labels, True), np.array([1, 0, 1, 1, 1, 0], bool))
    rows = counts.rows()
    assert rows["car, found"]["anywhere"] == 33.3
    assert rows["car, found"]["0 to 10 m"] == 100
    assert rows["car, found"]["10 to 20 m"] == 0
    assert rows["person, found"]["anywhere"] == 100
    assert rows["IoU"]["20 to 30 m"] == 50  # a parked car is called moving
    assert rows["IoU"]["anywhere"] == 50
    assert rows["IoU"]["30 to 50 m"] is None


def test_movers_are_told_apart_by_what_they_do():
    points = np.full((4, 4), 5, np.float32)
    labels = np.array([252 | 1 << 16, 252 | 2 << 16, 254 | 3 << 16, 10 | 4 << 16], np.uint32)
    counts = Counts()
    counts.add(Scan(points, np.eye(4), labels, True, {1: "crossing", 2: "starting", 3: "crossing"}), labels < 3 << 16)
    rows = counts.rows()
    assert rows["crossing, found"]["anywhere"] == 50
    assert rows["starting, found"]["0 to 10 m"] == 100
    assert "oncoming, found" not in rows


def test_the_file_says_which_streets_they_were(tmp_path):
    file = tmp_path / "movers.json"
    bench(BUNDLE, count=2, frames=1, threads=1, out=file)
    found = json.loads(file.read_text())
    assert found["seeds"] == [STREETS, STREETS + 1]
    assert "IoU" in found["percent"]
