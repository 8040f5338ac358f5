"""Sequences indoors."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mos_model.simulator import SimulationSettings, simulate
from mos_model.simulator.boxes import bounds
from mos_model.simulator.placing import clearance
from mos_model.simulator.settings import ROOMS, draw_room
from runtime.classes import MOVING, to_classes


@pytest.mark.parametrize("kind", ROOMS)
def test_a_room_is_closed(kind):
    for seed in range(8):
        drive = simulate(seed, 2, "rs16", street=kind, body=False, imperfections=False, scan_motion="off")
        assert drive.settings.version == 2
        room, points = drive.world, drive[1].points
        fired = drive.profile.azimuth_steps * drive.profile.beams
        far = np.linalg.norm(points[:, :3], axis=1)
        assert len(points) > 0.6 * fired
        inside = far < np.hypot(room.length, room.width) + 10
        assert inside.mean() > 0.6  # all but what windows show
        height = (points[:, :3] @ drive.true_poses[1][:3, :3].T + drive.true_poses[1][:3, 3])[inside, 2]
        assert height.min() > -0.1
        assert (height > room.height + 0.1).mean() < 0.05  # likewise


def test_nothing_stands_where_the_sensor_is_and_nobody_in_a_wall():
    moving = []
    for seed in range(30):
        drive = simulate(seed, 10, "vlp16", street=ROOMS[seed % 3], movers=1.5)
        prims, boxes = drive.world.prims, bounds(drive.world.prims)
        places = drive.traffic.ego
        assert clearance(prims, boxes, np.column_stack([places[:, :2], np.zeros(len(places))])) > 0.2
        for track in drive.traffic.tracks:
            if track.labels[1] == 254:
                spots = np.column_stack([track.states[:, :2], np.zeros(len(places))])
                assert clearance(prims, boxes, spots) > 0.1
        frame = drive[9]
        world = (frame.points[:, :3] @ frame.true_pose[:3, :3].T + frame.true_pose[:3, 3])[:, :2]
        people = (frame.labels & 0xFFFF) == 254
        corner = 0.5 * np.hypot(drive.world.length, drive.world.width)
        assert (np.hypot(*world[people].T) < corner + 1).all()
        moving.append((to_classes(frame.labels) == MOVING).mean())
    assert sum(share > 0.005 for share in moving) > 8
    assert np.median(moving) < 0.15


def test_a_standing_sensor_in_a_still_room_sees_the_same_twice():
    drive = simulate(
        4, 3, "rs16", street="room", ego="standing", movers=0, pose_noise=0, imperfections=False, body=False
    )
    one, two = drive[0], drive[2]
    assert drive.traffic.tracks == []
    np.testing.assert_allclose(one.pose, two.pose, atol=1e-9)
    apart = cKDTree(two.points[:, :3]).query(one.points[:, :3])[0]
    assert np.quantile(apart, 0.95) < 0.06


def test_rooms_come_in_version_2():
    drawn = [draw_room(seed, SimulationSettings(version=2)) for seed in range(1000)]
    assert 0.09 < np.mean([bool(room) for room in drawn]) < 0.15
    assert {*drawn} == {"", *ROOMS}
    assert not any(draw_room(seed, SimulationSettings()) for seed in range(50))
    assert draw_room(1, SimulationSettings(street="hall")) == "hall"
    assert draw_room(1, SimulationSettings(street="urban", version=2)) == ""


def test_rooms_are_of_all_sizes_and_deterministic():
    rooms = [simulate(seed, 1, "vlp16", street=ROOMS[seed % 3]) for seed in range(30)]
    lengths, heights = np.array([r.world.length for r in rooms]), np.array([r.world.height for r in rooms])
    assert lengths.min() < 6
    assert lengths.max() > 35
    assert heights.min() < 2.7
    assert heights.max() > 6
    mounts = np.array([r.scanner.rig.mount[0] for r in rooms])
    assert mounts.min() > 0.3
    assert mounts.max() < 1.8
    again = simulate(3, 1, "vlp16", street=ROOMS[0])
    np.testing.assert_array_equal(again[0].points, rooms[3][0].points)
