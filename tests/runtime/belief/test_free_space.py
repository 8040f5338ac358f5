"""What other scans see through, against loops in float64."""

import numpy as np
import pytest

from runtime.belief.free_space import ACROSS, ASIDE, LATER, PER_METRE, STRIDE, FreeSpace
from runtime.bundle.manifest import BeliefNumbers
from runtime.bundle.residual import HISTORY
from runtime.compute.workers import Workers
from runtime.sensors.range_image import RangeImage
from tests.support.reference_inputs import project_point, range_image
from tests.support.sights import RANGE_IMAGE

NUMBERS = BeliefNumbers(look_back=17, through=1.0, ended=-10.0, unseen=0.1)
BEAMS = RangeImage(16, 96, 20.0, -20.0, elevations=tuple(np.linspace(19, -18, 15) + 0.5 * np.sin(np.arange(15))))


def drive(count, seed=0):
    """Scans (N, 4) of clouds that turn up and go, from a sensor that drives and turns."""
    rng = np.random.default_rng(seed)
    for t in range(count):
        pose = np.eye(4)
        angle = 0.05 * t
        pose[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        pose[:3, 3] = 0.3 * t, -0.1 * t, 0.02 * t
        direction = rng.normal(0, 1, (2500, 3)) * (1, 1, 0.3)
        distance = rng.choice([6.0, 6.4, 9.0, 20.0], len(direction)) + rng.normal(0, 0.05, len(direction))
        points = direction / np.linalg.norm(direction, axis=1, keepdims=True) * distance[:, None]
        yield np.c_[points, np.full(len(points), 0.2)].astype(np.float32), pose


def state(image, point, sensor):
    """Weight of a look; None where rounding decides."""
    u, v, r = project_point(*map(float, point), sensor)
    for step in np.concatenate([np.eye(3), -np.eye(3)]) * 4e-4 * r:  # rows of beams are found in bins of 0.02 degrees
        if project_point(*map(float, point + step), sensor)[:2] != (u, v):
            return None
    if v in (0, sensor.height - 1):
        return NUMBERS.unseen
    columns = [(u + step) % sensor.width for step in range(-ACROSS, ACROSS + 1)]
    ranges = [image[v, column] for column in columns if image[v, column] > 0]
    ahead = min(ranges, default=0) - r
    near = float(ASIDE) + float(PER_METRE) * r
    if abs(abs(ahead) - near) < 1e-4:
        return None
    if not ranges or ahead < -near:
        return NUMBERS.unseen
    return NUMBERS.through if ahead > near else NUMBERS.ended


@pytest.mark.parametrize("sensor", [RANGE_IMAGE, BEAMS], ids=["equal angles", "beams"])
@pytest.mark.parametrize(("later", "threads"), [(0, 1), (5, 2), (20, 2)])
def test_like_the_reference(sensor, later, threads):
    scans = list(drive(32))
    space = FreeSpace(NUMBERS, sensor, Workers(threads), later)
    images, sights, met = [], [], set()
    for points, pose in scans:
        image = range_image(points, sensor).astype(np.float32)
        sight = space.sight(points, pose, image)
        if later:
            space.add(sight)
        images.append(image)
        sights.append(sight)
        judged = len(sights) - 1 - later
        if judged == 10:
            start = np.where(np.arange(len(points)) % 3, 0.5, -0.5).astype(np.float32)
            log_odds = start.copy()
            space.weigh(sights[judged], log_odds, 0.0)
            lags = [*range(HISTORY + 1, NUMBERS.look_back + 1, STRIDE)]
            lags += [-lag for lag in range(STRIDE, LATER + 1, STRIDE) if lag <= later]
            others = [judged - lag for lag in lags if judged - lag >= 0]
            assert len(others) == 1 + (later >= STRIDE) + (later >= LATER)
            for i, point in enumerate(sights[judged].points[:, :3].astype(np.float64)):
                moves = [np.linalg.inv(scans[other][1]) @ scans[judged][1] for other in others]
                places = [move[:3, :3] @ point + move[:3, 3] for move in moves]
                said = [state(images[other], place, sensor) for other, place in zip(others, places, strict=True)]
                if None not in said:
                    met |= set(said)
                    assert log_odds[i] == pytest.approx(start[i] + (sum(said) if start[i] >= 0 else 0), abs=1e-5)
        if not later:
            space.add(sight)
    assert met == {NUMBERS.through, NUMBERS.ended, NUMBERS.unseen}


def seen(space, count):
    """The last of some scans, added but for it."""
    *before, last = [space.sight(points, pose, range_image(points, RANGE_IMAGE)) for points, pose in drive(count)]
    for number, sight in enumerate(before):
        space.add(space.sight(sight.points, sight.pose, sight.range_image.astype(np.float32)))
        assert number + 1 == space.sight(last.points, last.pose, last.range_image).number
    return space.sight(last.points, last.pose, last.range_image)


def weighed(space, sight):
    log_odds = np.zeros(len(sight.points), np.float32)
    space.weigh(sight, log_odds, 0.0)
    return log_odds


@pytest.mark.parametrize("forget", [FreeSpace.clear, lambda space: space.lay_out(RANGE_IMAGE)])
def test_what_is_forgotten_says_nothing(forget):
    space = FreeSpace(NUMBERS, RANGE_IMAGE, Workers(1))
    sight = seen(space, 12)
    assert weighed(space, sight).any()
    forget(space)
    assert not weighed(space, sight).any()


def test_only_the_last_scans_count_and_memory_stays():
    space = FreeSpace(NUMBERS, RANGE_IMAGE, Workers(1))
    short, held = FreeSpace(NUMBERS, RANGE_IMAGE, Workers(1)), space.nbytes
    sight = seen(space, 60)
    before = [space.sight(points, pose, range_image(points, RANGE_IMAGE)) for points, pose in drive(59)]
    for one in before[-NUMBERS.look_back :]:
        short.add(short.sight(one.points, one.pose, one.range_image))
    same = short.sight(sight.points, sight.pose, sight.range_image)
    np.testing.assert_array_equal(weighed(space, sight), weighed(short, same))
    assert space.nbytes == held
    assert len(space._poses) <= NUMBERS.look_back + 1


def test_without_looks_nothing_is_kept():
    space = FreeSpace(BeliefNumbers(look_back=0), RANGE_IMAGE, Workers(1))
    assert not weighed(space, seen(space, 40)).any()
    assert space.nbytes == 0
