"""The point head on ONNX Runtime, from a bundle: which engine a runner takes, and that it makes no difference.

Other configurations, and small scans, are compared in `tests/export/test_head_graph.py`.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from runtime import MosRunner
from runtime.bundle.head_shape import FULL, LITE
from runtime.bundle.loading import load_bundle
from runtime.compute.sessions import CPU, Execution
from runtime.compute.workers import Workers
from runtime.errors import BundleError, ProviderError, SettingError
from runtime.head import onnx_engine as onnx_head
from runtime.head.numba_engine import PointHeadEngine
from runtime.head.onnx_engine import OnnxHead, choose_head, joins
from runtime.head.voxels import voxelise
from tests.runtime.test_runner import drive
from tests.support import reference_voxels as reference
from tests.support.paths import BUNDLE


@pytest.fixture(scope="module")
def bundle():
    return load_bundle(BUNDLE)


@pytest.fixture(scope="module")
def head(bundle):
    return choose_head(bundle, Workers(2), "onnx")


@pytest.fixture
def without_graph(tmp_path):
    """The tiny bundle without `point_head.onnx`."""
    folder = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    (folder / "point_head.onnx").unlink()
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["files"]["point_head.onnx"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def scan(seed=0, count=3000, extent=20.0):
    random = np.random.default_rng(seed)
    features = random.normal(size=(count, 4)).astype(np.float32)
    return reference.surfaces(seed, count, extent), random.random(count) > 0.05, features


def test_both_engines_agree(bundle, head):
    numba = choose_head(bundle, Workers(2))
    assert isinstance(numba, PointHeadEngine)
    assert isinstance(head, OnnxHead)
    xyz, valid, features = scan()
    candidates = np.abs(xyz - xyz[5]).max(axis=1) < 1
    for asked in ((), (candidates,), (candidates, "exact"), (np.zeros_like(valid),)):
        found, want = (engine.refine(xyz, valid, features, *asked) for engine in (head, numba))
        np.testing.assert_allclose(found, want, atol=1e-6)
        assert head.voxels == numba.voxels
        assert head.timing.keys() == numba.timing.keys()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_small_scans(bundle, head, count):
    args = np.full((count, 3), 2, np.float32), np.ones(count, bool), np.ones((count, 4), np.float32)
    np.testing.assert_allclose(head.refine(*args), choose_head(bundle, Workers(1)).refine(*args), atol=1e-6)


def test_results_stay_and_arrays_are_not_written(head):
    args = scan(1)
    copies = [array.copy() for array in args]
    for array in args:
        array.setflags(write=False)
    first = head.refine(*args)
    kept = first.copy()
    head.refine(*scan(2, 5000))
    np.testing.assert_array_equal(first, kept)
    for array, copy in zip(args, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    np.testing.assert_array_equal(head.refine(*args), kept)


@pytest.mark.parametrize("level", [1, 2])
def test_tables(head, level):
    """Against a naive head: neighbours, interpolation and means of every point."""
    xyz, valid, _ = scan(3, 800, 2.0)
    voxels = voxelise(xyz, 0.05, Workers(1), valid)
    tables = head._tables(voxels.keys)
    coords = voxels.coords >> level
    coarse, first, counts = np.unique(coords, axis=0, return_index=True, return_counts=True)
    order = np.argsort(np.argsort(first))  # of each in the order of keys
    rows = {tuple(xyz): int(row) for xyz, row in zip(coarse.tolist(), order, strict=True)}
    assert len(tables[f"neighbours{level}"]) == len(coarse)
    for place, row in rows.items():
        want = [rows.get(tuple(np.add(place, offset)), len(rows)) for offset in reference.CUBE3]
        np.testing.assert_array_equal(tables[f"neighbours{level}"][row], want)
    assert set(tables[f"place{level - 1}"] // 8) == set(range(len(rows)))
    if level not in joins(head.config):
        return
    values = np.arange(len(rows) + 1.0) ** 2
    values[-1] = 0
    found = (values[tables[f"corners{level}"]] * tables[f"nearness{level}"]).sum(axis=1)
    inside = (voxels.coords - (coords << level)) / 2**level
    for i, place in enumerate(coords.tolist()):
        total = weights = 0.0
        for corner in reference.CUBE2:
            row = rows.get(tuple(np.add(place, corner)))
            weight = np.prod(np.where(corner, inside[i], 1 - inside[i]))
            total, weights = (total + weight * values[row], weights + weight) if row is not None else (total, weights)
        assert found[i] == pytest.approx(total / weights, rel=1e-5)
    np.testing.assert_allclose(tables[f"share{level}"][order, 0], 1 / counts)


def test_scales_of_the_joins():
    assert (joins(LITE), joins(FULL)) == ([2], [4, 2])


@pytest.mark.parametrize("refine", ["near", "all"])
def test_a_runner_gives_the_same_with_either_engine(refine):
    runners = [MosRunner(BUNDLE, threads=2, refine=refine, head_engine=engine) for engine in ("auto", "numba", "onnx")]
    assert [type(runner._stages.refiner.head) for runner in runners] == [PointHeadEngine, PointHeadEngine, OnnxHead]
    for frame in drive(10):
        first, *others = (runner(*frame) for runner in runners)
        for other in others:
            np.testing.assert_allclose(other.probability, first.probability, atol=1e-5)
            assert (other.moving == first.moving).mean() > 0.999


def test_a_scan_without_points_and_with_one():
    runner = MosRunner(BUNDLE, threads=1, refine="all", head_engine="onnx")
    for scan in (np.empty((0, 4)), np.full((1, 4), 3.0), np.full((2, 4), np.nan)):
        result = runner(scan, np.eye(4))
        assert result.moving.shape == (len(scan),)
        assert np.isfinite(result.probability).all()


def test_auto_takes_the_graph_on_a_gpu(bundle, without_graph, monkeypatch):
    monkeypatch.setattr(onnx_head, "GPU", (CPU,))  # so that the test needs none
    given, none = Execution([(CPU, {}), "OpenVINOExecutionProvider"]), Execution(["OpenVINOExecutionProvider"])
    assert choose_head(bundle, Workers(1), "auto", given).providers == [CPU]
    assert isinstance(choose_head(load_bundle(without_graph), Workers(1), "auto", given), PointHeadEngine)
    assert isinstance(choose_head(bundle, Workers(1), "numba", given), PointHeadEngine)
    assert isinstance(choose_head(bundle, Workers(1), "auto", none), PointHeadEngine)


def test_settings_that_cannot_be(bundle, without_graph):
    with pytest.raises(SettingError, match="must be one of auto, numba, onnx, not 'gpu'"):
        MosRunner(BUNDLE, threads=1, head_engine="gpu")
    with pytest.raises(SettingError, match=r"has no point_head\.onnx; `mos export --point-head-onnx` makes it"):
        MosRunner(without_graph, threads=1, head_engine="onnx")
    with pytest.raises(ProviderError, match="Abacus"):
        choose_head(bundle, Workers(1), "onnx", Execution(["AbacusExecutionProvider"]))
    with pytest.raises(BundleError, match="is not the graph of this point head"):
        OnnxHead(BUNDLE / "point_head.onnx", LITE, Workers(1))
    with pytest.raises(BundleError, match="is not the graph of this point head"):
        OnnxHead(BUNDLE / "image_net.onnx", bundle.manifest.point_head, Workers(1))


def test_a_graph_without_a_point_head_is_an_error(tmp_path):
    folder = Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest |= {"point_head": None, "postprocess": "none"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(BundleError, match=r"point_head\.onnx is there, but no 'point_head'"):
        load_bundle(folder)
