"""All primitives of a sequence, the standing ones and those of the traffic, at one moment."""

import numpy as np

from mos_model.simulator.boxes import bounds
from mos_model.simulator.placing import place
from mos_model.simulator.raycast import COLUMNS
from mos_model.simulator.rooms import Room
from mos_model.simulator.traffic import Track
from mos_model.simulator.world import World

MOVING_SPEED = 0.5  # m/s, an object that is faster at the time of the scan is moving
STANDING_SPEED = 0.15  # m/s, one that is slower is static; in between it is unlabelled


class Scene:
    """Primitives, their boxes, and the velocity and label of each object; objects of the world come first."""

    def __init__(self, world: World | Room, tracks: list[Track]) -> None:
        self.world, self.tracks, self.frame = world, tracks, 0
        self._first = np.cumsum([len(world.prims), *(len(track.shape) for track in tracks)])
        self._objects = len(world.labels)  # that stand still for ever
        self.prims = np.zeros((int(self._first[-1]), COLUMNS))
        self.prims[: len(world.prims)] = world.prims
        self._shapes = []
        for k, track in enumerate(tracks):
            shape = track.shape.copy()
            shape[:, 15] = self._objects + k
            self._shapes.append(shape)
        self.velocity = np.zeros((self._objects + len(tracks), 2))  # (objects, 2) m/s
        self.labels = np.concatenate([world.labels, np.zeros(len(tracks), np.uint32)])  # (objects,)
        self.boxes = bounds(self.prims)

    def instance(self, track: int) -> int:
        """The instance id of a track in the labels."""
        return (self._objects + track + 1) & 0xFFFF

    def move_to(self, k: int) -> None:
        """Put the traffic where it is at frame k."""
        self.frame = k
        for i, track in enumerate(self.tracks):
            x, y, yaw, speed, walked, lift, vigour, stir = track.states[k].tolist()
            pose = np.array((x, y, self.world.terrain.height_at(x, y) + lift, yaw))
            place(self._shapes[i], pose, walked, vigour, self.prims, int(self._first[i]))
            before, after = track.states[max(k - 1, 0)], track.states[min(k + 1, len(track.states) - 1)]
            way = after[:2] - before[:2]
            self.velocity[self._objects + i] = speed * way / max(float(np.hypot(*way)), 1e-9)
            standing, moving = track.labels
            fastest = max(speed, stir)
            label = moving if fastest > MOVING_SPEED else standing if fastest < STANDING_SPEED else 0
            self.labels[self._objects + i] = label | self.instance(i) << 16
        first = len(self.world.prims)
        self.boxes[first:] = bounds(self.prims[first:])
