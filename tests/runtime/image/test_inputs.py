"""Projection and network input against the naive reference, and against a published input of a real scan."""

import numpy as np
import pytest

from runtime.bundle.residual import Residual
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.image.history import Past
from runtime.image.inputs import InputBuilder
from runtime.image.projection import BIN
from runtime.sensors.range_image import RangeImage
from tests.support.paths import SHARED
from tests.support.reference_inputs import input_image, project_point


def street(seed: int, count: int = 3000) -> np.ndarray:
    """Points (count, 4) f32 all around, some beyond the field of view, behind, and very near."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, count), np.radians(rng.uniform(-40, 20, count))
    r = rng.uniform(0.5, 70, count)
    xyz = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], 1)
    return np.concatenate([xyz * r[:, None], rng.uniform(0, 1, (count, 1))], 1).astype(np.float32)


def columns_and_rows(pixel: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Column and row of each point; -1 for points without a pixel."""
    v, u = np.divmod(pixel, width)
    return np.where(pixel < 0, -1, u), np.where(pixel < 0, -1, v)


def pose(seed: int, far: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    a = rng.uniform(-0.2, 0.2)
    t = np.eye(4)
    t[:2, :2] = [[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]
    t[:3, 3] = rng.uniform(-1, 1, 3) + far
    return t


def build(builder, points, past, relative):
    """The input of a scan and those before it, each with its T_current_past."""
    befores = [None if scan is None else Past(scan, pose) for scan, pose in zip(past, relative, strict=True)]
    return builder.build(builder.enter(points), befores)


@pytest.mark.parametrize("shape", [(64, 2048), (32, 1024), (128, 1024), (16, 16)])
@pytest.mark.parametrize("kind", ["absolute", "signed"])
@pytest.mark.parametrize("threads", [1, 2])
def test_input_equals_reference(shape, kind, threads):
    sensor = RangeImage(height=shape[0], width=shape[1])
    residual = Residual(lags=(1, 3, 8), kind=kind)
    points = street(0)
    past = [street(i) for i in range(1, 9)]
    relative = [pose(i) for i in range(1, 9)]
    got = build(InputBuilder(sensor, residual, Workers(threads)), points, past, relative)
    want = input_image(points, past, relative, sensor, residual)
    differs = (np.abs(got.image - want) > 1e-3 * (1 + np.abs(want))).any(axis=0)
    assert differs.sum() <= max(2, 1e-4 * differs.size)
    assert (got.image[5:] != 0).any()


def test_every_point_keeps_its_pixel():
    sensor = RangeImage()
    points = street(5)
    got = build(InputBuilder(sensor, Residual(), Workers(2)), points, [], [])
    want = np.array([project_point(*p[:3].astype(np.float64), sensor) for p in points])
    u, v = columns_and_rows(got.pixel, sensor.width)
    assert (u != want[:, 0]).sum() + (v != want[:, 1]).sum() <= 1
    np.testing.assert_allclose(got.distance, want[:, 2], rtol=1e-6)
    nearest = got.nearest[v, u]
    assert (nearest <= got.distance).all()
    assert (got.nearest[got.first >= 0] == got.distance[got.first[got.first >= 0]]).all()


UNEVEN = RangeImage(
    height=16, width=512, fov_up=17, fov_down=-28, elevations=(15, 8, 5, 3, 2, 1.5, 1, 0.5, 0, -1, -3, -8, -25)
)


def test_rows_follow_a_table_of_beams():
    """To within a bin of elevation; a row without a beam stays empty."""
    points = street(6)
    points = points[np.linalg.norm(points[:, :3], axis=1) > 2]
    got = build(InputBuilder(UNEVEN, Residual(), Workers(2)), points, [points], [np.eye(4)])
    _, row = columns_and_rows(got.pixel, UNEVEN.width)
    elevation = np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))
    away = np.abs(elevation[:, None] - np.array(UNEVEN.elevations))
    assert (away[np.arange(len(row)), row] <= away.min(1) + 2 * BIN).all()
    assert set(row) == set(range(13))
    assert not got.image[5].any()  # the past is projected by the same table
    want = input_image(points, [], [], UNEVEN, Residual())
    differs = (np.abs(got.image[:5] - want[:5]) > 1e-3 * (1 + np.abs(want[:5]))).any(axis=0)
    assert differs.sum() <= 0.01 * len(points)


@pytest.mark.parametrize(
    "wrong", [{"elevations": (1, 2)}, {"elevations": (9, 1)}, {"elevations": (*range(0, -17, -1),)}]
)
def test_a_table_that_cannot_be_is_refused(wrong):
    with pytest.raises(SettingError, match="elevations"):
        RangeImage(height=16, **wrong)


@pytest.mark.parametrize(
    ("point", "u", "v"),
    [
        ((10, 0, 0), 1024, 6),  # ahead: the middle column
        ((-10, 1e-9, 0), 0, 6),  # behind, just left of the seam
        ((-10, -1e-9, 0), 2047, 6),
        ((0, 10, 0), 512, 6),  # left
        ((0, -10, 0), 1536, 6),
        ((0, 0, 10), 1024, 0),  # straight up: no azimuth, clamped into the first row
        ((0, 0, -10), 1024, 63),
        ((1e-3, 0, 0), 1024, 6),
    ],
)
def test_corners_of_the_projection(point, u, v):
    got = build(InputBuilder(RangeImage(), Residual(), Workers(1)), np.array([[*point, 0]], np.float32), [], [])
    assert got.pixel.tolist() == [v * 2048 + u]


def test_points_without_direction_have_no_pixel():
    points = street(1, 50)
    points[3, :3] = 0
    points[7, 1] = np.nan
    points[9, 2] = np.inf
    points[11, 0] = -np.inf
    points[13, :3] = 3e38  # the norm overflows
    got = build(InputBuilder(RangeImage(), Residual(), Workers(1)), points, [points], [np.eye(4)])
    assert set(np.flatnonzero(got.pixel < 0)) == {3, 7, 9, 11, 13}
    assert (got.distance[got.pixel < 0] == 0).all()
    assert np.isfinite(got.image).all()


def test_residual_by_hand():
    now = np.array([[10, 0, 0, 0], [0, 60, 0, 0], [0, -1, 0, 0]], np.float32)  # the others are out of 2..50 m
    before = np.array([[12, 0, 0, 0], [0, 40, 0, 0], [0, -8, 0, 0]], np.float32)
    back = np.eye(4)
    back[0, 3] = 1.0  # the past scan was taken 1 m ahead
    for kind, want in (("absolute", 0.3), ("signed", 0.3)):
        image = build(
            InputBuilder(RangeImage(), Residual(lags=(1,), kind=kind), Workers(1)), now, [before], [back]
        ).image
        assert image[5, 6, 1024] == pytest.approx(want, rel=1e-6)
        assert (image[5] != 0).sum() == 1
    nearer = np.array([[5, 0, 0, 0]], np.float32)
    signed = build(
        InputBuilder(RangeImage(), Residual(lags=(1,), kind="signed"), Workers(1)), now, [nearer], [np.eye(4)]
    )
    assert signed.image[5, 6, 1024] == pytest.approx(-0.5)


def test_a_lag_without_scan_is_zero_and_buffers_hold_no_past():
    builder = InputBuilder(RangeImage(), Residual(), Workers(2))
    points, past = street(0), [street(i) for i in range(1, 9)]
    assert (build(builder, points, past, [np.eye(4)] * 8).image[5:] != 0).any(axis=(1, 2)).all()
    image = build(builder, points, [past[0], None], [np.eye(4), None]).image
    assert (image[5] != 0).any()
    assert (image[6:] == 0).all()


def test_empty_and_single():
    builder = InputBuilder(RangeImage(), Residual(), Workers(2))
    empty = build(builder, np.empty((0, 4), np.float32), [np.empty((0, 3), np.float32)], [np.eye(4)])
    assert (empty.image == 0).all()
    assert empty.pixel.shape == (0,)
    one = build(builder, np.array([[5, 0, 0, 0.5]], np.float32), [], [])
    assert (one.nearest > 0).sum() == 1


def test_inputs_are_not_written():
    points = street(0)
    points.setflags(write=False)
    before = points.copy()
    build(InputBuilder(RangeImage(), Residual(), Workers(2)), points, [points], [np.eye(4)])
    np.testing.assert_array_equal(points, before)


@pytest.mark.parametrize(
    "settings",
    [{"height": 60}, {"width": 0}, {"height": 64.0}, {"fov_up": -30.0}, {"fov_down": -91.0}, {"std": (1, 1, 1, 1, 0)}],
)
def test_bad_sensor(settings):
    with pytest.raises(SettingError):
        RangeImage(**settings)


@pytest.mark.parametrize("settings", [{"lags": ()}, {"lags": (0,)}, {"lags": (2, 1)}, {"lags": (9,)}, {"kind": "x"}])
def test_bad_residual(settings):
    with pytest.raises(SettingError):
        Residual(**settings)


@pytest.mark.skipif(not (SHARED / "data").is_dir(), reason="needs the real scans of ../shared/data")
def test_real_input():
    from runtime.recordings.registry import open_recording

    recording = open_recording(SHARED / "data/kitti/sequences/90")
    frames = [(scan.data, scan.pose) for scan in map(recording.read, range(12, 21))]
    (points, now), past = frames[-1], frames[-2::-1]
    relative = [np.linalg.inv(now) @ before for _, before in past]
    got = build(InputBuilder(RangeImage(), Residual(), Workers(2)), points, [scan for scan, _ in past], relative)
    want = np.load(SHARED / "published/input_90_000020.npz")
    for channel in range(13):
        differs = np.abs(got.image[channel] - want["input"][channel]) > 1e-4
        assert differs.mean() <= 1e-4, channel
    u, v = columns_and_rows(got.pixel, 2048)
    assert (u != want["u"]).mean() <= 1e-4
    assert (v != want["v"]).mean() <= 1e-4
    assert ((u < 0) == (want["u"] < 0)).all()
