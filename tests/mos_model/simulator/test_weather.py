"""What hangs in the air: how much of it is seen, where, and that it harms nothing else."""

from collections import Counter

import numpy as np
import pytest

from mos_model.simulator import SimulationSettings, airborne, simulate
from mos_model.simulator.settings import WEATHERS
from mos_model.simulator.weather import draw_weather

COLUMNS, BEAMS = 400, 50
EVEN = np.ones((1, 1, 1), np.float32)
IN_AIR = 99


def around(depth):
    """Rays all around from the origin, and what they hit at `depth` m: (rays, origin, level, drop), found."""
    azimuth = np.arange(COLUMNS)[:, None] * 2 * np.pi / COLUMNS
    up = np.radians(np.linspace(10, -10, BEAMS))[None]
    rays = np.stack([np.cos(azimuth) * np.cos(up), np.sin(azimuth) * np.cos(up), np.sin(up) + 0 * azimuth], 2)
    level = np.concatenate([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], 1)
    found = np.full((COLUMNS, BEAMS), depth, np.float32), np.full((COLUMNS, BEAMS), -2, np.int32)
    return (rays.astype(np.float32), np.zeros((COLUMNS, 3)), level, np.zeros(BEAMS)), (*found, np.zeros_like(found[0]))


def haze(depth, thickness=EVEN, share=0.4, outshone=0.0, surface=0.0):
    (rays, origin, _, drop), found = around(depth)
    airborne.cast_haze(
        rays, origin, drop, thickness, 4.0, np.zeros(3), share, np.ones(BEAMS), 1.5, 4.0, 60.0, outshone, surface, 5,
        *found,
    )  # fmt: skip
    return found


def test_share_and_ranges_of_even_fog():
    depth, hit, cosine = haze(np.inf)
    seen = hit == airborne.AIR
    assert seen.mean() == pytest.approx(0.4, abs=0.015)
    beyond = depth[seen] - 1.5
    assert beyond.min() >= 0
    assert beyond.mean() == pytest.approx(4.0, rel=0.05)
    assert np.median(beyond) == pytest.approx(4.0 * np.log(2), rel=0.05)
    assert (depth[~seen] == np.inf).all()
    assert ((cosine >= 0) & (cosine < 1)).all()


def test_fog_lies_before_its_targets_and_close_ones_outshine_it():
    depth, hit, _ = haze(5.5)
    seen = hit == airborne.AIR
    assert seen.mean() == pytest.approx(0.4 * (1 - np.exp(-1)), abs=0.015)
    assert (depth[seen] < 5.5).all()
    assert (depth[~seen] == np.float32(5.5)).all()
    dim = haze(5.5, outshone=5.5)[1] == airborne.AIR
    assert dim.mean() == pytest.approx(0.5 * seen.mean(), rel=0.08)


def test_fog_is_where_the_field_says():
    """Air in every second slab of 4 m along x alone: there firings end, but for steps across its border."""
    slabs = np.broadcast_to(np.array((2.0, 0.0), np.float32)[:, None, None], (2, 2, 2)).copy()
    depth, hit, _ = haze(np.inf, slabs)
    x = (around(1.0)[0][0][..., 0] * depth)[hit == airborne.AIR]
    assert len(x) > 2000
    assert (np.floor(x / 4) % 2 == 0).mean() > 0.9


def test_fog_may_look_like_a_surface():
    depth, hit, _ = haze(np.inf, share=1.0, surface=1.0)
    assert (hit == airborne.AIR).all()
    np.testing.assert_allclose(depth, 1.5 + 4.0 * airborne.SAME, rtol=1e-5)


def test_puffs_are_balls():
    (rays, origin, level, drop), found = around(np.inf)
    puff = np.array([[6.0, 3.0, 0.2, 1.5, 1.0]])
    airborne.cast_puffs(rays, origin, level, drop, puff, EVEN, 1.0, np.zeros(3), 0.5, 9, *found)
    depth, hit, _ = found
    seen = hit == airborne.AIR
    away = np.linalg.norm(rays[seen] * depth[seen][:, None] - puff[0, :3], axis=1)
    assert away.max() < 1.5 + 1e-4
    centre = puff[0, :3]
    missed = np.linalg.norm(np.cross(rays.astype(float), centre), axis=2)
    chord = 2 * np.sqrt(np.maximum(1.5**2 - missed**2, 0)) * (rays @ centre > 0)
    assert seen.sum() == pytest.approx((chord / 3.0).sum(), rel=0.08)
    assert not seen[chord == 0].any()


@pytest.mark.parametrize("weather", WEATHERS[1:])
def test_weather_is_static_and_the_same_again(weather):
    share = []
    for seed in range(3):
        drives = [simulate(seed, 3, "vlp16", weather=weather, street="urban") for _ in range(2)]
        frame, again = (drive[2] for drive in drives)
        np.testing.assert_array_equal(frame.points, again.points)
        np.testing.assert_array_equal(frame.labels, again.labels)
        air = frame.labels == IN_AIR
        share.append(air.mean())
        distance = np.linalg.norm(frame.points[air, :3], axis=1)
        assert (distance > 0.4).all()
        assert (frame.points[air, 3] < 0.45).all()
    assert 0 < max(share) < {"fog": 0.9, "dust": 0.5, "rain": 0.08, "snow": 0.08}[weather]


def test_nothing_else_changes_with_the_weather():
    clear, fog = (simulate(3, 2, "vlp16", weather=weather) for weather in ("clear", "fog"))
    np.testing.assert_array_equal(clear.poses, fog.poses)
    np.testing.assert_array_equal(clear.scene.prims, fog.scene.prims)
    assert (fog[1].labels == IN_AIR).mean() > 0.01
    far = [np.mean(np.linalg.norm(drive[1].points[:, :3], axis=1) > 40) for drive in (clear, fog)]
    assert far[1] < far[0]


def test_weather_of_the_versions():
    way = np.zeros((1, 3))
    drawn = {
        version: Counter(draw_weather(seed, SimulationSettings(version=version), 4, way).kind for seed in range(600))
        for version in (1, 2)
    }
    assert drawn[1] == {"clear": 600}
    shares = [drawn[2][kind] / 600 for kind in WEATHERS]
    np.testing.assert_allclose(shares, (0.78, 0.09, 0.06, 0.04, 0.03), atol=0.04)


@pytest.mark.parametrize(
    ("seed", "sensor", "points", "first", "last", "total"),
    [
        (7, "hdl64e", 103428, (34.176, 1.075, 1.487, 0.5), (3.827, -1.439, -1.677, 0.24), (-70710, 280286, -105908)),
        (5, "hdl32e", 65355, (45.764, 8.119, 9.289, 0.59), (3.189, -0.014, -1.904, 0.16), (-7444, 55733, -45970)),
    ],
)
def test_version_1_stays_what_it_was(seed, sensor, points, first, last, total):
    """What networks were trained on; to a millimetre, as processors round differently."""
    frame = simulate(seed, 2, sensor)[1]
    assert len(frame.points) == pytest.approx(points, abs=3)
    np.testing.assert_allclose(frame.points[[0, -1]], (first, last), atol=1.5e-3)
    np.testing.assert_allclose(frame.points[:, :3].sum(axis=0, dtype=float), total, atol=60)
