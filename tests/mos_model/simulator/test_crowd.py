"""People and small vehicles of version 2."""

from random import Random

import numpy as np
import pytest

from mos_model.simulator import shapes, simulate
from mos_model.simulator.boxes import bounds
from mos_model.simulator.pedestrians import pedestrian
from mos_model.simulator.placing import clearance, place
from mos_model.simulator.scene import MOVING_SPEED, STANDING_SPEED

PERSON = 254


def people(drive):
    return [track for track in drive.traffic.tracks if track.labels[1] == PERSON]


def placed(figure, walked, vigour):
    rows = shapes.array(figure.shape)
    out = np.empty_like(rows)
    place(rows, np.zeros(4), walked, vigour, out, 0)
    return out


def test_knees_bend_backwards_and_limbs_hang_together():
    figure = pedestrian(Random(0), runs=True)
    limbs = shapes.array(figure.shape)[:, 16:19].any(axis=1).nonzero()[0]
    assert len(limbs) == 4
    rest = placed(figure, 0.0, 0.0)
    length = np.linalg.norm(rest[:, 9:12] - rest[:, 6:9], axis=1)
    for walked in np.linspace(0, figure.stride, 9):
        now = placed(figure, walked, 1.0)
        np.testing.assert_allclose(now[limbs, 6:9], now[limbs - 1, 9:12], atol=1e-12)
        rods = np.append(limbs, limbs - 1)
        np.testing.assert_allclose(np.linalg.norm(now[rods, 9:12] - now[rods, 6:9], axis=1), length[rods], rtol=1e-9)
        lean = np.arctan2(now[:, 9] - now[:, 6], now[:, 8] - now[:, 11])  # forward from hanging down
        for shank in limbs[:2]:
            assert lean[shank] < lean[shank - 1] + 0.23  # the toes are before the ankle
        for forearm in limbs[2:]:
            assert lean[forearm] > lean[forearm - 1]
    np.testing.assert_array_equal(rest, placed(figure, 0.4, 0.0))  # who stands keeps still


def test_bodies_have_the_size_of_people():
    for seed in range(200):
        figure = pedestrian(Random(seed))
        rows = placed(figure, 0.0, 1.0)
        boxes = bounds(rows)
        top = (rows[:, 3] + boxes[:, 5]).max()
        assert 0.8 < top < 2.5
        assert -0.12 < (rows[:, 3] + boxes[:, 2]).min() < 0.2
        assert len(rows) <= 18


@pytest.mark.parametrize("street", ["urban", "residential", "open"])
def test_many_people_at_all_ranges_and_none_in_a_wall(street):
    away, before = [], 0
    for seed in range(16):
        drive = simulate(seed, 8, "vlp16", street=street, movers=1.0, version=2, ego="standing")
        before += len(people(simulate(seed, 8, "vlp16", street=street, movers=1.0, ego="standing")))
        world, boxes = drive.world, bounds(drive.world.prims)
        for track in people(drive):
            place = track.states[:, :2]
            away += np.hypot(*(place - drive.traffic.ego[:, :2]).T).tolist()[:1]
            spots = np.column_stack([place, world.terrain.heights_at(*place.T)])
            assert clearance(world.prims, boxes, spots) > 0.1
    assert len(away) > 1.5 * before
    counts = np.histogram(away, (2, 10, 20, 30, 45, 60))[0]
    assert (counts > 0.04 * len(away)).all(), counts


def test_clearance_against_a_naive_one():
    drive = simulate(3, 2, "vlp16", street="urban", version=2)
    prims, boxes = drive.world.prims, bounds(drive.world.prims)
    rng = np.random.default_rng(0)
    for _ in range(20):
        spots = drive.traffic.ego[0, :2] + rng.uniform(-30, 30, 2) + rng.uniform(-2, 2, (4, 2))
        spots = np.column_stack([spots, drive.world.terrain.heights_at(*spots.T)])
        least = 9.0
        for x, y, floor in spots:
            for row, box in zip(prims, boxes, strict=True):
                turn = np.array([(row[4], row[5]), (-row[5], row[4])])
                own = turn @ (x - row[1], y - row[2])
                if box[2] + row[3] <= floor + 1.8 and box[5] + row[3] >= floor + 0.2:
                    beyond = np.maximum(np.maximum(box[:2] - own, own - box[3:5]), 0)
                    least = min(least, np.hypot(*beyond))
        np.testing.assert_allclose(clearance(prims, boxes, spots), least, atol=1e-9)


def test_who_keeps_still_is_static_and_who_stirs_moves():
    seen = {"still": 0, "turning": 0, "walking": 0}
    for seed in range(12):
        drive = simulate(seed, 6, "vlp16", street="urban", movers=1.5, version=2)
        drive.scene.move_to(3)
        for i, track in enumerate(drive.traffic.tracks):
            if track.labels[1] != PERSON:
                continue
            label = drive.scene.labels[len(drive.world.labels) + i] & 0xFFFF
            speed, stir = track.states[3, 3], track.states[3, 7]
            if speed < STANDING_SPEED and stir == 0:
                assert label == 30
                seen["still"] += 1
            elif speed > MOVING_SPEED or stir > MOVING_SPEED:
                assert label == PERSON
                seen["walking" if speed > MOVING_SPEED else "turning"] += 1
    assert min(seen.values()) > 2, seen


def test_some_towns_are_full_of_scooters():
    shares = []
    for seed in range(40):
        tracks = simulate(seed, 2, "vlp16", street="urban", movers=1.0, version=2).traffic.tracks
        vehicles = [track for track in tracks if track.labels[1] != PERSON]
        if len(vehicles) > 30:
            shares.append(np.mean([track.labels[1] == 255 for track in vehicles]))
    assert 1 < sum(share > 0.5 for share in shares) < 12


def test_version_2_is_deterministic():
    one, two = (simulate(31, 3, "vlp16", version=2)[2] for _ in range(2))
    np.testing.assert_array_equal(one.points, two.points)
    np.testing.assert_array_equal(one.labels, two.labels)
