"""The parts of the point head's benchmark that decide something."""

import numpy as np
import pytest

from bench import sparse_layer
from bench.head_growth import merged, with_voxels
from bench.head_scans import busiest
from bench.point_head import targets
from bench.sparse_layer import OTHERS, compare
from runtime.compute.workers import Workers
from runtime.head.voxels import voxelise
from tests.support import reference_voxels as reference


def cloud(seed, count=500):
    return np.pad(reference.surfaces(seed, count, 3.0), ((0, 0), (0, 1)))


def voxels(points):
    return len(voxelise(points[:, :3], 0.05, Workers(1)).keys)


def test_scans_are_merged_in_the_frame_of_the_first():
    first, world = np.eye(4), np.eye(4)
    first[:3, 3], world[:3, 3] = (5e6, 1, 0), (5e6 + 2, 1, 0)
    points = cloud(0)
    points[3] = 0  # at the origin: no return
    both = merged([(points, first), (points, world)])
    assert both.shape == (998, 4)
    np.testing.assert_allclose(both[499:, :3] - both[:499, :3], np.tile(np.float32([2, 0, 0]), (499, 1)), atol=1e-5)


def test_a_cloud_has_as_many_voxels_as_asked_for():
    points = cloud(1)
    assert voxels(points) > 300
    assert [voxels(with_voxels(points, count)) for count in (1, 77, 300)] == [1, 77, 300]
    assert with_voxels(points, 10_000) is points


def test_layers_are_compared_and_a_missing_library_is_named(monkeypatch, capsys):
    def missing(*_):
        raise ImportError("No module named 'spconv'")

    monkeypatch.setattr(sparse_layer, "spconv_layer", missing)
    found = voxelise(cloud(2)[:, :3], 0.05, Workers(1))
    rows = compare(found.keys, found.coords, 16, 1, 1)
    assert "median" in rows["this"]
    assert float(rows[OTHERS[0]]["difference"]) < 1e-4
    assert "not installed" in rows["spconv"]["note"]
    reached = targets({"layers": {"layer": rows}})
    assert reached["layer, times faster than spconv"]["met"] == "not installed"
    assert "layer, times faster than spconv" in capsys.readouterr().out.replace("\n", "")


def test_targets_can_be_missed():
    rows = {
        "% candidates": 1.0,
        "default halo": {"% of whole": 12.5, "% same label": 99.4},
        "exact halo": {"difference": "2.0e-06", "median": 80.0},
    }
    found = targets({"refinement": rows})
    met = {what: row.get("met") for what, row in found.items()}
    assert met == {
        "refinement, candidates, % of the points": True,
        "refinement, default halo, % of whole scan": False,
        "refinement, default halo, % same label": False,
        "refinement, exact halo, difference": True,
        "refinement, exact halo, ms": None,
    }


def test_a_sequence_without_fitting_labels_is_an_error(tmp_path):
    for name in ("labels", "velodyne"):
        (tmp_path / name).mkdir()
    np.full(10, 252, np.uint32).tofile(tmp_path / "labels" / "000000.label")
    np.ones((10, 4), np.float32).tofile(tmp_path / "velodyne" / "000000.bin")
    with pytest.raises(ValueError, match="at most 2 % of moving points"):
        busiest(tmp_path)
