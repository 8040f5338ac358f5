"""Vehicles that are hard to tell from standing ones: those that creep, leave a parking place, keep the sensor's own
speed ahead of it, or are far away; and streets full of scooters."""

import math
from random import Random

import numpy as np

from mos_model.simulator import cycles, vehicles
from mos_model.simulator.motion import Path, Speed, draw_speed
from mos_model.simulator.roads import turning_path
from mos_model.simulator.traffic import CAR, CYCLIST, MOTORCYCLE, Traffic, poisson

AROUND = 60.0  # m, where scooters are drawn


def add_manoeuvres(rng: Random, traffic: Traffic) -> None:
    """Add some of each."""
    many = min(traffic.density, 1.5)
    for add, usual in ((_creep, 0.8), (_leave_parking, 1.2), (_keep_ahead, 0.7), (_far, 1.5), (_glide, 0.6)):
        if add is not _keep_ahead or not traffic.drive.mounting.robot:
            for _ in range(min(poisson(rng, usual * many), 4)):
                add(rng, traffic)


def _lane(rng: Random, traffic: Traffic) -> tuple[Path, float]:
    """A lane of the main road, either way, and the place on it next to where the sensor comes to."""
    road = traffic.world.roads[0]
    aside = (rng.randrange(road.lanes) + 0.5) * road.lane_width
    path = Path(road.line(-aside) if rng.random() < 0.5 else road.line(aside, road.length, 0.0))
    x, y, _ = traffic.ego[rng.randrange(len(traffic.ego))].tolist()
    return path, float(path.s[np.hypot(path.points[:, 0] - x, path.points[:, 1] - y).argmin()])


def _creep(rng: Random, traffic: Traffic) -> None:
    path, here = _lane(rng, traffic)
    speed = draw_speed(rng, rng.choice(("constant", "constant", "pull_away")), rng.uniform(0.3, 1.0), traffic.duration)
    traffic.add(*traffic.vehicle(), path, here + rng.uniform(-35, 35), speed)


def _far(rng: Random, traffic: Traffic) -> None:
    path, here = _lane(rng, traffic)
    speed = draw_speed(rng, "constant", rng.uniform(*traffic.world.style.speed), traffic.duration)
    away = rng.choice((-1, 1)) * rng.uniform(45, 85)
    traffic.add(*traffic.vehicle(), path, here + away - 0.5 * speed.at(traffic.times[-1:])[0][0], speed)


def _keep_ahead(rng: Random, traffic: Traffic) -> None:
    """At the sensor's own speed, so that it looks as if it stood beside the road that passes."""
    own = traffic.drive.speed
    pace = own.speed * rng.uniform(0.97, 1.03)
    ahead = traffic.drive.start + rng.choice((1, 1, 1, -1)) * rng.uniform(10, 40)
    traffic.add(*traffic.vehicle(), traffic.drive.path, ahead, Speed(traffic.duration, pace, own.times))


def _leave_parking(rng: Random, traffic: Traffic) -> None:
    road = traffic.world.roads[0]
    forward = rng.random() < 0.5
    aside, out = road.half - 0.5 * max(road.parking, 1.9), 0.5 * road.lane_width
    if road.parking == 0:
        aside = road.half + 1.3
    at = _lane(rng, traffic)[1]
    s = (at if forward else road.length - at) + rng.uniform(-35, 35)
    x, y, yaw = road.at(min(max(s, 5.0), road.length - 5.0), -aside if forward else aside)
    if not traffic.world.is_free(x, y, yaw, -2.6, 2.6, 0.9):
        return
    kerb, lane = ((road.line(-a) if forward else road.line(a, road.length, 0.0)) for a in (aside, out))
    i = int(np.hypot(kerb[:, 0] - x, kerb[:, 1] - y).argmin())
    i = min(max(i, 3), len(kerb) - 25)
    if i < 3:
        return
    path = Path(turning_path(kerb[: i + 3], lane[i + 10 :], 1.0))
    kind = rng.choice(("pull_away", "pull_away", "constant"))
    speed = draw_speed(rng, kind, rng.uniform(0.8, 4.0), traffic.duration, 1.5)
    traffic.add(vehicles.car, CAR, path, max(i - 1.0, 0.0), speed)


def _glide(rng: Random, traffic: Traffic) -> None:
    """Somebody on an electric scooter, on the road or beside it."""
    road = traffic.world.roads[0]
    aside = road.half + rng.choice((-0.7, 0.5 * traffic.world.terrain.walk))
    forward = rng.random() < 0.5
    path = Path(road.line(-aside) if forward else road.line(aside, road.length, 0.0))
    x, y, _ = traffic.ego[rng.randrange(len(traffic.ego))].tolist()
    here = path.s[np.hypot(path.points[:, 0] - x, path.points[:, 1] - y).argmin()]
    speed = draw_speed(rng, rng.choice(("constant", "constant", "pull_away")), rng.uniform(1.5, 6.5), traffic.duration)
    traffic.add(cycles.kick_scooter, CYCLIST, path, float(here) + rng.gauss(0, 20), speed)


def add_scooters(rng: Random, traffic: Traffic) -> None:
    """Fill the lanes with scooters and motorcycles that weave at gaps of 2 to 10 m, and some cars among them."""
    for road in traffic.world.roads[:2]:
        for forward in (True, False):
            fast, share = rng.uniform(1.5, 9.0), rng.uniform(0.6, 0.7)
            width = road.lanes * road.lane_width
            for row in range(max(round(width / 1.6), 2)):
                aside = 0.6 + (width - 1.2) * (row + rng.random()) / max(round(width / 1.6), 2)
                lane = road.line(-aside) if forward else road.line(aside, road.length, 0.0)
                near = np.flatnonzero(np.hypot(*(lane - traffic.ego[len(traffic.ego) // 2, :2]).T) < AROUND)
                s = rng.uniform(0, 10) + (float(near[0]) if len(near) else road.length)
                while s < (near[-1] if len(near) else 0.0):
                    line = _weaving(rng, lane)
                    pace = fast * rng.uniform(0.75, 1.25)
                    kind = rng.choices(("constant", "stop_and_go", "brake", "pull_away"), (82, 6, 6, 6))[0]
                    speed = draw_speed(rng, kind, pace, traffic.duration)
                    small = rng.random() < share
                    draw, labels = (cycles.powered, MOTORCYCLE) if small else traffic.vehicle()
                    traffic.add(draw, labels, Path(line), s, speed)
                    s += rng.uniform(3, 11) if small else rng.uniform(7, 14)


def _weaving(rng: Random, line: np.ndarray) -> np.ndarray:
    """The line (n, 2), swaying to both sides."""
    k = np.arange(len(line))
    aside = rng.uniform(0.0, 0.45) * np.sin(2 * math.pi * k / rng.uniform(15, 50) + rng.uniform(0, 6.28))
    way = np.gradient(line, axis=0)
    way /= np.linalg.norm(way, axis=1, keepdims=True) + 1e-9
    woven: np.ndarray = line + aside[:, None] * np.stack([-way[:, 1], way[:, 0]], 1)
    return woven
