import numpy as np
import pytest

from runtime.pictures import Snapshot
from runtime.pictures.verdict import BACKGROUND, CAR_PAINT, COLOURS, FALSE_ALARM, FOUND, MISSED, STILL

Image = pytest.importorskip("PIL.Image")
from runtime.pictures.bird import draw_bird, pixels_of  # noqa: E402
from runtime.pictures.sheet import BIRD, CAPTION, GAP, HEAD, NARROW, STRIP, WIDTH, draw_sheet  # noqa: E402
from runtime.pictures.strip import draw_strip  # noqa: E402

SIZE, REACH = (400, 200), 20.0  # 10 pixels a metre


def ground(points=4000, seed=0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-18, 18, (points, 2)) * (1, 0.5)
    return np.column_stack([xy, np.full(points, -1.7), np.full(points, 0.2)]).astype(np.float32)


def snapshot(systems=("a",), labelled=True):
    points = ground()
    classes = np.ones(len(points), np.uint8)
    classes[:50] = 2
    moving = {
        name: (np.arange(len(points)) >= 25 * i) & (np.arange(len(points)) < 60) for i, name in enumerate(systems)
    }
    return Snapshot("00", 3, "000003", points, np.eye(4), classes if labelled else None, moving)


@pytest.mark.parametrize(
    ("place", "pixel"),
    [((10, 0), (300, 100)), ((-10, 0), (100, 100)), ((0, 8), (200, 20)), ((12.55, -6.25), (325, 162))],
)
@pytest.mark.parametrize("kind", [FOUND, MISSED, FALSE_ALARM])
def test_a_mover_is_seen_at_its_place_from_above(place, pixel, kind):
    """Forward is right, left is up; full colour among static points that lie higher."""
    points = np.concatenate([ground(), [[*place, -1, 0.5]]]).astype(np.float32)
    kinds = np.append(np.full(len(points) - 1, STILL), kind).astype(np.uint8)
    points[:-1, 2] = 3
    picture = np.asarray(draw_bird(points, kinds, SIZE, REACH))
    assert picture.shape == (200, 400, 3)
    assert tuple(picture[pixel[1], pixel[0]]) == COLOURS[kind]
    distance = np.abs(picture.astype(int) - COLOURS[kind]).sum(2)
    v, u = np.nonzero(distance < 30)
    assert abs(u - pixel[0]).max() <= 3
    assert abs(v - pixel[1]).max() <= 3
    column, row = pixels_of(points[-1:], SIZE, REACH)
    assert (int(column[0]), int(row[0])) == pixel


def test_the_car_and_the_rings_are_marked():
    picture = draw_bird(np.empty((0, 4), np.float32), np.empty(0, np.uint8), SIZE, REACH)
    assert picture.getpixel((190, 100)) == CAR_PAINT
    assert picture.getpixel((300, 60)) == BACKGROUND
    ring = np.asarray(picture)[:, :, 2].astype(int) - BACKGROUND[2]
    assert ring[100 - 71, 200 + 71] > 10  # 10 m, at 45 degrees
    assert ring[100 - 60, 200 + 60] == 0


@pytest.mark.parametrize(
    ("azimuth", "elevation", "pixel"), [(0, -5, (200, 0.5)), (90, -5, (100, 0.5)), (-135, -5, (350, 0.5))]
)
def test_a_mover_is_seen_in_its_direction(azimuth, elevation, pixel):
    """Left of the middle is left, and what is far does not cover it."""
    rng = np.random.default_rng(1)
    angles = np.radians(np.column_stack([rng.uniform(-180, 180, 20000), rng.uniform(-10, 0, 20000)]))
    angles[-300:] = np.radians([azimuth, elevation]) + rng.uniform(-0.02, 0.02, (300, 2))
    distance = np.where(np.arange(20000) < 19700, 30, 8)
    flat = np.cos(angles[:, 1]) * distance
    points = np.column_stack(
        [flat * np.cos(angles[:, 0]), flat * np.sin(angles[:, 0]), np.sin(angles[:, 1]) * distance, flat * 0]
    ).astype(np.float32)[::-1]
    kinds = np.where(np.arange(20000) < 300, FOUND, STILL).astype(np.uint8)
    picture = draw_strip(points, kinds, (400, 64))
    assert picture.size == (400, 64)
    assert picture.getpixel((pixel[0], round(64 * pixel[1]))) == COLOURS[FOUND]
    v, u = np.nonzero((np.asarray(picture) == COLOURS[FOUND]).all(2))
    assert abs(u - pixel[0]).max() < 6
    assert v.min() > 20
    assert v.max() < 44


@pytest.mark.parametrize(
    "points",
    [
        np.empty((0, 4)),
        np.zeros((3, 4)),
        np.full((3, 4), np.nan),
        [[np.inf, 0, 0, 0]],
        [[1e30, 1e30, 0, 0]],
        [[5, 0, 0, 0]],
    ],
)
def test_points_that_have_no_place(points):
    points = np.asarray(points, np.float32)
    points.setflags(write=False)
    kinds = np.full(len(points), FOUND, np.uint8)
    draw_bird(points, kinds, SIZE, REACH)
    strip = np.asarray(draw_strip(points, kinds, (400, 64)))
    shown = len(points) == 1 and np.isfinite(points).all()
    assert (strip[:40] != BACKGROUND).any() == shown  # names of directions are below


def test_side_by_side_has_a_panel_for_each():
    one, two = draw_sheet(snapshot()), draw_sheet(snapshot(("a", "b")))
    height = HEAD + CAPTION + STRIP + GAP + BIRD
    assert one.size == (WIDTH, height)
    assert two.size == (2 * NARROW + GAP, height)
    left, right = (np.asarray(two)[HEAD:, x : x + NARROW].astype(int) for x in (0, NARROW + GAP))
    missed = [(np.abs(half - COLOURS[MISSED]).sum(2) < 30).sum() for half in (left, right)]
    found = [(np.abs(half - COLOURS[FOUND]).sum(2) < 30).sum() for half in (left, right)]
    assert missed[0] == 0 < missed[1]
    assert found[0] > found[1] > 0
    static = (left[HEAD + CAPTION :] != right[HEAD + CAPTION :]).any(2).mean()
    assert static < 0.05  # the rest is the same


def test_the_legend_shows_only_what_there_is():
    def in_head(picture, kind):
        return (np.asarray(picture)[:HEAD] == COLOURS[kind]).all(2).any()

    full, plain = draw_sheet(snapshot()), draw_sheet(snapshot(labelled=False))
    assert all(in_head(full, kind) for kind in (FOUND, MISSED, FALSE_ALARM, STILL))
    assert in_head(plain, FOUND)
    assert not in_head(plain, MISSED)
    assert not in_head(plain, FALSE_ALARM)


def test_labels_alone():
    picture = draw_sheet(snapshot(systems=()))
    assert isinstance(picture, Image.Image)
    assert (np.asarray(picture)[HEAD:] == COLOURS[FOUND]).all(2).any()
