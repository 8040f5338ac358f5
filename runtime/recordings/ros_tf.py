"""TF, the tree of frames in a bag: where each sits in the one above it, once and for all or from time to time.

https://www.ros.org/reps/rep-0105.html: `map` above `odom` above `base_link` above the sensors.
"""

import logging
import warnings
from array import array
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.errors import MosWarning, PoseError, some
from runtime.recordings.bag import TF, Bag
from runtime.recordings.pose_table import from_quaternions
from runtime.recordings.poses import Pose, Poses
from runtime.recordings.trajectory import LONGEST_GAP, poses_at

STATIC = "tf_static"  # how a topic is called whose transforms hold for ever
SMOOTH = ("odom", "odom_combined")  # a world in which nothing jumps
WORLDS = (*SMOOTH, "map", "world", "camera_init")  # frames that do not move, as they are usually called
ROW = 8  # numbers: time, position, quaternion
STILL = 1e-6  # of a matrix; what changes less does not move

log = logging.getLogger("lidar_mos.recordings")


@dataclass(frozen=True)
class Link:
    """From a frame to the one above it."""

    parent: str
    rows: npt.NDArray[np.float64]  # (K, ROW) s, m, quaternion x y z w
    static: bool

    @cached_property
    def times(self) -> npt.NDArray[np.float64]:
        """(K,) s."""
        return self.rows[:, 0]

    @cached_property
    def poses(self) -> Poses:
        """(K, 4, 4) T_parent_child."""
        return from_quaternions(self.rows[:, 1:4], self.rows[:, 4:])

    @cached_property
    def fixed(self) -> bool:
        """Whether it never moves."""
        return self.static or bool((abs(self.poses - self.poses[0]) <= STILL).all())

    def at(self, times: npt.NDArray[np.float64], source: str) -> tuple[Poses, dict[int, str]]:
        """As `poses_at`; what is static is so at all times."""
        if self.static:
            return np.tile(self.poses[-1], (len(times), 1, 1)), {}
        return poses_at(times, self.times, self.poses, source, np.inf if self.fixed else LONGEST_GAP)


class Transforms:
    """What was said of frames, in order of time, from which a tree is made."""

    def __init__(self, seconds: float = np.inf) -> None:
        """seconds: of each moving frame, as much is kept, or up to twice that."""
        self._seconds = seconds
        self._rows: dict[tuple[str, str, bool], array[float]] = defaultdict(lambda: array("d"))
        self._said = set[str]()

    def add(self, content: Any, received: int, static: bool) -> None:
        """A message of TF. received: ns; static: its topic is that of transforms that hold for ever."""
        for one in content.transforms:
            stamp, place, turn = one.header.stamp, one.transform.translation, one.transform.rotation
            time = stamp.sec + 1e-9 * stamp.nanosec or 1e-9 * received
            rows = self._rows[plain(one.child_frame_id), plain(one.header.frame_id), static]
            if static or (rows and time < rows[-ROW] - self._seconds):  # or a recording is played once more
                del rows[:]
            elif rows and time - rows[0] > 2 * self._seconds:
                table = np.array(rows).reshape(-1, ROW)
                rows[:] = array("d", table[table[:, 0] >= time - self._seconds].ravel())
            rows.extend((time, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))

    def frames(self, source: str, world: str | None = None) -> "Frames":
        """The tree. Of several frames above one, that counts by which `world` or `odom` is reached, or which is said
        most often. The logger is told where that decides; a MosWarning, where nothing but the number does."""
        above: dict[str, list[tuple[str, bool]]] = defaultdict(list)
        for child, parent, static in sorted(self._rows, key=lambda key: -len(self._rows[key])):
            above[child].append((parent, static))
        links = dict[str, Link]()
        for child, parents in above.items():
            chosen = max(parents, key=lambda one: _leads(one[0], above, world))  # the first of several
            if len(parents) > 1:
                others = some(sorted({parent for parent, _ in parents}))
                leading = {_leads(parent, above, world) for parent, _ in parents}
                self._say(f"{source}: TF has {child} twice, below {others}; {chosen[0]} counts", len(leading) > 1)
            rows = np.array(self._rows[child, *chosen]).reshape(-1, ROW)
            links[child] = Link(chosen[0], rows, chosen[1])
        return Frames(source, links, world)

    def _say(self, text: str, decided: bool) -> None:
        """Once. decided: it is known why."""
        if text not in self._said:
            self._said.add(text)
            if decided:
                log.info("%s, which the chosen world is above, or odom, where nothing jumps (`world`)", text)
            else:
                warnings.warn(text, MosWarning, stacklevel=4)


class Frames:
    """The tree."""

    def __init__(self, source: str, links: dict[str, Link], world: str | None = None) -> None:
        """links: by the frame that is below; world: the frame in which poses are to be; None: see `world`."""
        self.source, self.links, self._world = source, links, world

    @classmethod
    def of(cls, bag: Bag, world: str | None = None) -> "Frames":
        """All that a bag says of them. Raises ScanError."""
        transforms, topics = Transforms(), tf_topics(bag)
        for topic in topics:
            kind = bag.topics()[topic][0]
            for message in bag.messages(topic):
                content = bag.decoded(message, kind, f"{bag.path}: {topic}")
                transforms.add(content, message.received, is_static(topic))
        return transforms.frames(f"{bag.path}: {' and '.join(topics)}", world)

    def chain(self, frame: str) -> list[str]:
        """`frame` and all above it. Raises PoseError where it goes round."""
        above = [frame]
        while above[-1] in self.links:
            above.append(self.links[above[-1]].parent)
            if above[-1] in above[:-1]:
                raise PoseError(f"{self.source}: its frames go round: {' below '.join(above)}")
        return above

    def mount(self, body: str, frame: str) -> Pose | None:
        """T_body_frame (4, 4) of two frames that never move against each other; None where TF does not say."""
        (top, frame_in_top), (other, body_in_top) = self._fixed(frame), self._fixed(body)
        return np.asarray(np.linalg.inv(body_in_top) @ frame_in_top) if top == other else None

    def missing(self, frame: str | None) -> str:
        """Why there are no poses of a frame: nothing that moves is above it; "" where there are. None: see `body`."""
        if frame is None:
            return f"{self.source}: not one frame moves, but none or several, of which `extrinsics` may be"
        chain = self.chain(frame)
        if self._world is not None and self._world not in chain[1:]:
            above = some(chain[1:], most=12) or "nothing"
            return f"{self.source}: {self._world} (`world`) is not above {frame}, but {above}"
        if len(chain) > 1 and (self._world or self._moving(chain) or any(_name(one) in WORLDS for one in chain)):
            return ""
        known = some(sorted({*self.links, *(link.parent for link in self.links.values())}), most=12) or "none"
        found = f"ends at {chain[-1]}, and nothing moves up to there" if len(chain) > 1 else "has nothing above it"
        return f"{self.source}: {chain[0]} {found}; there are the frames {known}"

    def world(self, frame: str) -> str:
        """In which the poses of a frame are: as chosen, or `odom`, or else the highest, above something that moves."""
        if self._world is not None:
            return self._world
        chain = self.chain(frame)
        above = chain[chain.index(self._moving(chain) or chain[-1]) :]
        return next((one for one in above if _name(one) in SMOOTH), chain[-1])

    def poses(self, world: str, frame: str, times: npt.NDArray[np.float64]) -> tuple[Poses, dict[int, str]]:
        """T_world_frame (T, 4, 4) at `times` (T,) s, and which are not known, and why."""
        poses, broken = np.tile(np.eye(4), (len(times), 1, 1)), dict[int, str]()
        chain = self.chain(frame)
        for child in chain[: chain.index(world)]:
            link = self.links[child]
            found, missing = link.at(times, f"{self.source}: {link.parent} to {child}")
            poses, broken = found @ poses, missing | broken
        return poses, broken

    def body(self) -> str | None:
        """The one frame that moves and has none below it that does; None where there are several, or none."""
        moving = [child for child, link in self.links.items() if not link.fixed]
        above = {one for child in moving for one in self.chain(child)[1:]}
        lowest = [child for child in moving if child not in above]
        return lowest[0] if len(lowest) == 1 else None

    def _moving(self, chain: list[str]) -> str | None:
        """The lowest frame of a chain in which the one below it moves."""
        return next((self.links[one].parent for one in chain[:-1] if not self.links[one].fixed), None)

    def _fixed(self, frame: str) -> tuple[str, Pose]:
        """The highest frame against which `frame` never moves, and T_highest_frame."""
        pose = np.eye(4)
        for child in self.chain(frame)[:-1]:
            link = self.links[child]
            if not link.fixed:
                return child, pose
            pose = link.poses[-1] @ pose
        return self.chain(frame)[-1], pose


def tf_topics(bag: Bag) -> list[str]:
    """Topics that hold transforms."""
    return [topic for topic, (kind, count) in bag.topics().items() if kind in TF and count]


def is_static(topic: str) -> bool:
    """Whether the transforms of a topic hold for ever."""
    return topic.rpartition("/")[2] == STATIC


def plain(frame: str) -> str:
    """A frame's name without the slash that ROS 1 once put before it."""
    return frame.lstrip("/")


def _leads(parent: str, above: dict[str, list[tuple[str, bool]]], world: str | None) -> bool:
    """Whether the chosen world, or `odom`, is a frame or above it."""
    seen, ahead = set[str](), [parent]
    while ahead:
        if (one := ahead.pop()) not in seen:
            seen.add(one)
            ahead += [other for other, _ in above.get(one, ())]
    return world in seen if world is not None else any(_name(one) in SMOOTH for one in seen)


def _name(frame: str) -> str:
    """Without the name of the robot before it."""
    return frame.rpartition("/")[2]
