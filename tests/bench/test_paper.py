"""The paper's tables: a training that stops and goes on, and what seeds can tell apart."""

import json

import numpy as np
import pytest
import typer

from bench import paper
from bench.accuracy import Scan
from bench.paper_tables import METHODS, claims, runtimes, spread, summary

pytestmark = pytest.mark.filterwarnings("ignore::runtime.errors.MosWarning")  # of a tilted sensor

TINY = {"seeds": 1, "steps": 2, "head_steps": 1, "batch": 2, "drives": 1, "frames": 10, "tests": 2, "threads": 1}


def run(runs, **changes):
    settings = {"methods": "rt", "channels": 4, "kitti": None, "minutes": 60.0, "out": runs.parent / "paper.json"}
    paper.bench(runs, **{**TINY, **settings, **changes})
    return json.loads((runs.parent / "paper.json").read_text())


def test_what_is_done_stays_and_the_rest_is_named(tmp_path, monkeypatch, capsys):
    none = run(tmp_path / "runs", minutes=0.0)
    assert (none["percent"], none["remaining"]) == ({"test": {"rt": []}}, ["rt of seed 0"])
    assert "remaining: rt of seed 0" in capsys.readouterr().out
    found = run(tmp_path / "runs")
    assert found["remaining"] == []
    (of_seed,) = found["percent"]["test"]["rt"]
    assert set(of_seed) == {"none", "knn", "head"}
    assert all(0 <= value <= 100 for value in of_seed.values())
    (manifest,) = tmp_path.glob("runs/rt-0/bundle/manifest.json")
    decision = json.loads(manifest.read_text())["sensors"][0]["decision"]
    assert decision["threshold"] is not None
    assert decision["head_threshold"] is not None

    monkeypatch.setattr(paper, "run_training", None)  # whoever trains again fails
    monkeypatch.setattr(paper, "export_checkpoint", None)
    again = run(tmp_path / "runs")
    assert again["percent"] == found["percent"]
    with pytest.raises(typer.BadParameter, match="name another folder"):
        run(tmp_path / "runs", steps=3)


def test_a_training_that_was_stopped_goes_on(tmp_path, monkeypatch):
    whole = run(tmp_path / "whole" / "runs")
    minutes = paper.Piece.minutes
    monkeypatch.setattr(paper.Piece, "minutes", lambda piece: min(minutes(piece), 1e-9))  # one step a call
    for _ in range(3):
        run(tmp_path / "parts" / "runs")
    assert run(tmp_path / "parts" / "runs")["percent"] == whole["percent"]


def test_methods_that_there_are_not_are_named(tmp_path):
    with pytest.raises(typer.BadParameter, match="no method x: choose of a, b"):
        run(tmp_path / "runs", methods="a,x")


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_a_network_as_wide_as_the_others(name):
    settings = paper.Settings(6, 2, 1, 2, 1, 10, 2)
    model = settings.model(name)
    assert model.channels == 6
    assert (model.point_head is None) == (METHODS[name].kinds == ("none",))
    assert settings.recipe(1, 0, model).crop == pytest.approx(model.view.shape[2] / 4)


def three(none, knn, head):
    return {"none": none, "knn": knn, "head": head}


def test_what_seeds_tell_apart():
    seeds = {
        "a": [three(20.0, 21.0, 30.0), three(22.0, 23.2, 20.0)],
        "b": [three(31.0, 32.1, 30.0), three(29.0, 29.9, 40.0)],
    }
    pooled = spread(seeds, "none")
    assert pooled.freedom == 2
    assert pooled.deviation == pytest.approx(2**0.5)
    least = 4.303 * 2**0.5  # t of 95 % with 2 degrees of freedom
    assert pooled.least(2 / 2) == pytest.approx(least, rel=1e-3)
    between, within, head = claims(seeds)
    assert (between["better"], between["worse"]) == ("b, none", "a, none")
    assert (between["points"], between["paper"], between["separated"]) == (9.0, 2.7, True)
    assert between["seeds_for_the_papers"] == np.ceil(2 * (least / 2.74) ** 2)
    assert (within["better"], within["worse"]) == ("a, knn", "a, none")
    assert (within["points"], within["separated"]) == (1.1, True)  # by each seed, which differ by more than that
    assert not head["separated"]
    assert summary(seeds)["a"]["none"] == {"mean": 21.0, "deviation": 1.4, "seeds": 2, "paper": 58.11}


def test_of_one_seed_nothing_is_told_apart():
    claim, *_ = claims({"a": [three(20.0, 20.0, 20.0)], "b": [three(90.0, 90.0, 90.0)], "c": []})
    assert claim["points"] == 70
    assert claim["least_significant"] is None
    assert not claim["separated"]


def test_a_quarter_of_the_firings():
    azimuth = np.radians(np.arange(-179.9, 180, 0.05))
    points = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth, 0 * azimuth], 1)
    (scan,) = paper.fewer_firings(lambda: iter([Scan(points, np.eye(4), np.arange(len(points)), True)]), 4)()
    columns = (np.degrees(azimuth[scan.classes]) + 180) * 2048 / 360
    np.testing.assert_array_equal(columns.astype(int) % 4, 0)
    assert len(scan.points) == pytest.approx(len(points) / 4, rel=0.02)


def test_runtimes_are_those_that_were_measured():
    def one(ms):
        return {"ms": {"scan": {"median": ms}}}

    latency = {"machine": {"cpu": "A"}, "rows": {"v1, kNN": one(1000.0), "LiMoSeg": one(3.0), "another": one(1.0)}}
    found = runtimes(latency, {"machine": {"cpu": "B"}, "LiMoSeg": one(4.0), "Cylinder3D": one(5.0)})
    assert found == {
        "v1, kNN": {"ms": 1000.0, "cpu": "A", "paper": 41.81},
        "LiMoSeg": {"ms": 3.0, "cpu": "A", "paper": None},
        "Cylinder3D": {"ms": 5.0, "cpu": "B", "paper": 124.38},
    }
