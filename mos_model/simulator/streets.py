"""Kinds of streets."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StreetStyle:
    """What a kind of street looks like; ranges are (least, greatest), chances 0..1."""

    lanes: tuple[int, ...]  # per direction, drawn from these
    lane_width: tuple[float, float]  # m
    speed: tuple[float, float]  # m/s, of the traffic
    crossings: tuple[float, float]  # m between side roads
    bend: float  # 1/m, standard deviation of the curvature
    walk: tuple[float, float]  # m, sidewalk
    strip: tuple[float, float]  # m, strip beyond
    parked: float  # share of the kerb with parked cars
    buildings: float  # share of the frontage that is built up
    setback: tuple[float, float]  # m, sidewalk to buildings
    height: tuple[float, float]  # m, of buildings
    barriers: float  # share of the frontage with hedge, wall, fence or rail
    trees: float  # per 100 m of kerb
    poles: float  # per 100 m of kerb
    green: float  # trees and bushes per 1000 m2 beyond
    vehicles: float  # per lane and 100 m
    walkers: float  # per 100 m of street
    standing: float  # people standing, per 100 m of street


STYLES = {
    "residential": StreetStyle(
        lanes=(1,),
        lane_width=(2.6, 3.4),
        speed=(5, 13),
        crossings=(50, 160),
        bend=0.006,
        walk=(1.2, 2.5),
        strip=(0, 3),
        parked=0.55,
        buildings=0.6,
        setback=(0.5, 8),
        height=(5, 12),
        barriers=0.55,
        trees=2.0,
        poles=2.0,
        green=3.0,
        vehicles=0.7,
        walkers=2.0,
        standing=0.8,
    ),
    "urban": StreetStyle(
        lanes=(1, 1, 2),
        lane_width=(2.8, 3.6),
        speed=(6, 15),
        crossings=(50, 150),
        bend=0.003,
        walk=(2, 6),
        strip=(0, 2),
        parked=0.5,
        buildings=0.85,
        setback=(0, 3),
        height=(9, 25),
        barriers=0.15,
        trees=3.0,
        poles=5.0,
        green=0.5,
        vehicles=1.3,
        walkers=4.5,
        standing=2.0,
    ),
    "highway": StreetStyle(
        lanes=(2, 2, 3),
        lane_width=(3.4, 3.8),
        speed=(20, 34),
        crossings=(400, 900),
        bend=0.0008,
        walk=(0.2, 1.5),
        strip=(2, 8),
        parked=0.0,
        buildings=0.05,
        setback=(10, 40),
        height=(6, 15),
        barriers=0.85,
        trees=1.0,
        poles=2.0,
        green=5.0,
        vehicles=1.4,
        walkers=0.02,
        standing=0.02,
    ),
    "country": StreetStyle(
        lanes=(1,),
        lane_width=(2.7, 3.6),
        speed=(10, 24),
        crossings=(150, 500),
        bend=0.004,
        walk=(0.2, 1.5),
        strip=(2, 8),
        parked=0.02,
        buildings=0.12,
        setback=(5, 25),
        height=(4, 10),
        barriers=0.3,
        trees=2.5,
        poles=1.0,
        green=5.0,
        vehicles=0.7,
        walkers=0.3,
        standing=0.1,
    ),
    "open": StreetStyle(
        lanes=(1, 2),
        lane_width=(3.0, 4.0),
        speed=(3, 14),
        crossings=(60, 200),
        bend=0.004,
        walk=(1, 4),
        strip=(2, 15),
        parked=0.15,
        buildings=0.25,
        setback=(10, 35),
        height=(5, 20),
        barriers=0.1,
        trees=1.0,
        poles=1.5,
        green=0.6,
        vehicles=0.7,
        walkers=2.0,
        standing=0.7,
    ),
}
