"""The engine against the published network, a naive head, and itself."""

import threading
from dataclasses import replace

import numba
import numpy as np
import pytest

from export.bundle.head_weights import fold
from runtime.bundle.head_shape import FULL, LITE, PointHeadConfig, receptive_field
from runtime.compute.workers import Workers
from runtime.errors import BundleError, InferenceError, ScanError, SettingError
from runtime.head.numba_engine import FeatureMap, PointHeadEngine
from tests.support import reference_voxels as reference

SMALL = PointHeadConfig(in_channels=5, down=(6, 20), up=(17, 9), fuse_after_up=None)
DEEP = PointHeadConfig(in_channels=8, down=(8, 12, 16), up=(12, 16, 8), fuse_after_up=1, voxel_size=0.1)


def engine(config, seed=0, threads=2):
    return PointHeadEngine(fold(reference.random_weights(config, seed), config), config, Workers(threads))


def scan(seed=0, count=700, channels=5, extent=3.0):
    """(xyz, valid, features); one point in twenty is not valid."""
    random = np.random.default_rng(seed)
    xyz = reference.surfaces(seed, count, extent)
    valid = random.random(count) > 0.05
    return xyz, valid, random.normal(size=(count, channels)).astype(np.float32)


@pytest.mark.parametrize(("name", "config"), [("lite", LITE), ("full", FULL)])
def test_published_network(name, config):
    data = np.load(reference.PUBLISHED / f"point_head_{name}.npz")
    weights = fold(reference.published_weights(name), config)
    head = PointHeadEngine(weights, config, Workers(2))
    valid = np.ones(len(data["xyz"]), bool)
    found = head.refine(data["xyz"], valid, data["point_features"])
    assert np.abs(found - data["probabilities"]).max() <= 1e-5
    assert head.multiply_adds > 1e9


@pytest.mark.parametrize(
    "config",
    [
        SMALL,
        replace(SMALL, reduce="mean", voxel_size=0.11),
        DEEP,
        replace(DEEP, fuse_after_up=2),
        PointHeadConfig(in_channels=16, down=(16,), up=(16,), fuse_after_up=None),
    ],
)
@pytest.mark.parametrize("threads", [1, 2])
def test_any_configuration(config, threads):
    """Channel counts that fill no vector, other depths, voxel sizes and reductions."""
    xyz, valid, features = scan(1, 500, config.in_channels)
    found = engine(config, 3, threads).refine(xyz, valid, features)
    expected = reference.refine(reference.random_weights(config, 3), config, xyz, valid, features)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_feature_map():
    """The image's features by pixel give the same bits as the points' own, also without a pixel."""
    random = np.random.default_rng(2)
    image = random.normal(size=(5, 16, 32)).astype(np.float32)
    xyz, valid, _ = scan(2)
    pixel = random.integers(0, 16 * 32, len(xyz)).astype(np.int32)
    pixel[::50] = -1
    features = np.where(pixel[:, None] >= 0, image.reshape(5, -1)[:, pixel].T, 0)
    for config in (SMALL, replace(SMALL, reduce="mean")):
        head = engine(config)
        expected = head.refine(xyz, valid, features)
        assert np.array_equal(head.refine(xyz, valid, FeatureMap(image, pixel, 32)), expected, equal_nan=True)
    wide = FeatureMap(image.repeat(4, axis=2), pixel, 128)  # four pixels of a row have the same features
    assert np.array_equal(
        head.refine(xyz, valid, FeatureMap(image, pixel, 128)), head.refine(xyz, valid, wide), equal_nan=True
    )


@pytest.mark.parametrize("config", [SMALL, DEEP, replace(SMALL, reduce="mean")])
@pytest.mark.parametrize("seed", range(4))
def test_exact_halo(config, seed):
    """Candidates get the result of a full run, to the last bit but for the order of sums; others get NaN."""
    xyz, valid, features = scan(seed, 3000, config.in_channels, 20.0)
    random = np.random.default_rng(seed)
    candidates = np.zeros(len(xyz), bool)
    for centre in xyz[random.integers(0, len(xyz), 3)]:
        candidates |= (np.abs(xyz - centre) < 0.5).all(axis=1)
    head = engine(config, seed)
    full = head.refine(xyz, valid, features)
    whole = head.voxels
    found = head.refine(xyz, valid, features, candidates, "exact")
    asked = candidates & valid
    assert asked.any()
    np.testing.assert_allclose(found[asked], full[asked], atol=1e-5)
    assert np.isnan(found[~asked]).all()
    assert head.voxels < whole


def test_receptive_field_is_tight():
    """A voxel at the edge of the receptive field reaches the result, none beyond does."""
    reach = receptive_field(SMALL)
    assert (reach, receptive_field(LITE)) == (44, 44)
    x = np.arange(0, 2 * reach + 40) * 0.05 + 1
    xyz = np.stack((x, np.ones_like(x), np.ones_like(x)), axis=1).astype(np.float32)
    valid, farthest = np.ones(len(xyz), bool), 0
    features = np.random.default_rng(0).normal(size=(len(xyz), 5)).astype(np.float32)
    for seed in range(4):
        head = engine(SMALL, seed)
        before = head.refine(xyz, valid, features)
        for changed in range(reach + 2, reach + 6):  # each place in the coarsest grid
            other = features.copy()
            other[changed] = 1e5
            moved = np.flatnonzero((head.refine(xyz, valid, other) != before).any(axis=1))
            farthest = max(farthest, np.abs(moved - changed).max())
    assert farthest == reach


def test_narrow_halo():
    xyz, valid, features = scan(5, 3000, 5, 20.0)
    candidates = np.abs(xyz - xyz[7]).max(axis=1) < 1
    head = engine(SMALL)
    full = head.refine(xyz, valid, features)
    sizes, errors = [], []
    for halo in (0.0, 0.5, 1.0, "exact"):
        found = head.refine(xyz, valid, features, candidates, halo)
        assert np.array_equal(np.isfinite(found[:, 0]), candidates & valid)
        sizes.append(head.voxels)
        errors.append(np.abs(found - full)[candidates & valid].max())
    assert sizes == sorted(sizes)
    assert errors[-1] <= 1e-5 < errors[0]
    for wrong in (-0.1, float("nan"), float("inf"), "wide"):
        with pytest.raises(SettingError, match="halo"):
            head.refine(xyz, valid, features, candidates, wrong)


def test_candidates_all_none_and_invalid():
    xyz, valid, features = scan(6)
    head = engine(SMALL)
    full = head.refine(xyz, valid, features)
    assert np.array_equal(head.refine(xyz, valid, features, np.ones(700, bool), 0.0), full, equal_nan=True)
    for nobody in (np.zeros(700, bool), ~valid):
        assert np.isnan(head.refine(xyz, valid, features, nobody)).all()
        assert head.voxels == head.multiply_adds == 0


@pytest.mark.parametrize("config", [SMALL, DEEP])
@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_small_scans(config, count):
    """Nothing, one voxel, all points in one voxel, duplicates."""
    random = np.random.default_rng(count)
    head, weights = engine(config), reference.random_weights(config)
    features = random.normal(size=(count, config.in_channels)).astype(np.float32)
    for spread in (0.0, 0.01, 3.0):
        xyz = np.full((count, 3), 2.01, np.float32) + random.uniform(0, spread, (count, 3)).astype(np.float32)
        found = head.refine(xyz, np.ones(count, bool), features)
        expected = reference.refine(weights, config, xyz, np.ones(count, bool), features)
        np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.isnan(head.refine(xyz, np.zeros(count, bool), features)).all()


def test_points_without_coordinates():
    """They take no part, and what they hold does not matter."""
    xyz, valid, features = scan(8)
    head = engine(SMALL)
    bad = np.arange(700) % 40 == 0
    expected = head.refine(xyz, valid & ~bad, features)
    xyz[bad] = [[np.nan, 0, 1]]
    xyz[40, 0] = np.inf
    assert np.array_equal(head.refine(xyz, valid & ~bad, features), expected, equal_nan=True)


def test_features_that_are_not_finite():
    xyz, valid, features = scan(13)
    head = engine(SMALL)
    expected = head.refine(xyz, valid, features)
    broken = features.copy()
    broken[np.flatnonzero(valid)[0]] = np.nan
    with pytest.raises(InferenceError, match="not finite"):
        head.refine(xyz, valid, broken)
    assert np.array_equal(head.refine(xyz, valid, features), expected, equal_nan=True)


def test_callers_arrays():
    """Read-only, strided and float64 input gives the same; nothing is written; results stay as they are."""
    xyz, valid, features = scan(9)
    head = engine(SMALL)
    first = head.refine(xyz, valid, features)
    kept = first.copy()
    copies = [xyz.copy(), valid.copy(), features.copy()]
    for array in (xyz, valid, features):
        array.flags.writeable = False
    assert np.array_equal(head.refine(xyz, valid, features), kept, equal_nan=True)
    assert all(np.array_equal(a, b) for a, b in zip((xyz, valid, features), copies, strict=True))
    wide = np.zeros((700, 8), np.float32)
    wide[:, :3], wide[:, 3:] = xyz, features
    assert np.array_equal(head.refine(wide[:, :3], valid, wide[:, 3:]), kept, equal_nan=True)
    assert np.array_equal(head.refine(xyz.astype(np.float64), valid.astype(np.uint8), features), kept, equal_nan=True)
    head.refine(xyz + np.float32(0.3), valid, -features)
    assert np.array_equal(first, kept, equal_nan=True)


def test_wrong_input_leaves_the_engine_usable():
    xyz, valid, features = scan(10)
    head = engine(SMALL)
    expected = head.refine(xyz, valid, features)
    far = xyz.copy()
    far[3] = 3e5
    image, pixel = np.zeros((5, 8, 8), np.float32), np.zeros(700, np.int32)
    for args in (
        (far, valid, features),
        (xyz[:, :2], valid, features),
        (xyz, valid[1:], features),
        (xyz, valid, features[:, :4]),
        (xyz, valid, features[1:]),
        (xyz, valid, FeatureMap(image[:4], pixel, 8)),
        (xyz, valid, FeatureMap(image, pixel[1:], 8)),
        (xyz, valid, FeatureMap(image, pixel, 12)),
        (xyz, valid, FeatureMap(image[0], pixel, 8)),
        (xyz, valid, FeatureMap(image, pixel.astype(np.int64), 8)),
        (xyz, valid, FeatureMap(image, pixel + 10**6, 8)),
        (xyz, valid, features, valid[1:]),
    ):
        with pytest.raises(ScanError):
            head.refine(*args)
    assert np.array_equal(head.refine(xyz, valid, features), expected, equal_nan=True)


def test_workspaces_do_not_grow():
    head = engine(SMALL)
    scans = [scan(seed, count) for seed, count in enumerate((900, 200, 700, 1))]
    for args in scans:
        head.refine(*args)
    held = head.workspace
    for args in scans * 3:
        head.refine(*args)
    assert head.workspace == held


def test_threads_do_not_disturb_each_other():
    """Two engines, and one engine called twice at a time; Numba's setting stays what it was."""
    before = numba.get_num_threads()
    args = scan(11, 2000)
    heads = [engine(SMALL), engine(SMALL)]
    expected = heads[0].refine(*args)
    results = []

    def run(head):
        results.extend(head.refine(*args) for _ in range(3))

    threads = [threading.Thread(target=run, args=(head,)) for head in (*heads, heads[0])]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 9
    assert all(np.array_equal(result, expected, equal_nan=True) for result in results)
    assert numba.get_num_threads() == before


def test_engine_names_what_is_wrong():
    weights = fold(reference.random_weights(SMALL), SMALL)
    half = {key: value.astype(np.float16) for key, value in weights.items()}
    assert PointHeadEngine(half, SMALL, Workers(1)).config is SMALL
    changes = [
        ("stem.weight", None, "stem.weight is missing"),
        ("stem.weight", np.zeros((27, 5, 4), np.float32), "not floats of shape (27, 5, 5)"),
        ("stem.bias", np.zeros(5, np.int64), "stem.bias is int64"),
        ("stem.bias", np.full(5, np.nan, np.float32), "stem.bias is not finite"),
        ("more", np.zeros(1, np.float32), "more is unknown"),
    ]
    for key, value, text in changes:
        wrong = {**weights, key: value}
        if value is None:
            del wrong[key]
        with pytest.raises(BundleError, match="point head") as error:
            PointHeadEngine(wrong, SMALL, Workers(1))
        assert text in str(error.value)


def test_other_seeds_of_the_published_layout():
    """The naive head agrees with the engine on the published sizes too (few points: it is slow)."""
    xyz, valid, features = scan(12, 150, 32, 1.0)
    weights = reference.published_weights("lite", 7)
    found = PointHeadEngine(fold(weights, LITE), LITE, Workers(2)).refine(xyz, valid, features)
    np.testing.assert_allclose(found, reference.refine(weights, LITE, xyz, valid, features), atol=1e-5)
