"""TF, the tree of frames in a bag: where each sits in the one above it, once and for all or from time to time.

https://www.ros.org/reps/rep-0105.html: `map` above `odom` above `base_link` above the sensors.
"""

import warnings
from array import array
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property

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
STILL = 1e-6  # of a matrix; what changes less does not move


@dataclass(frozen=True)
class Link:
    """From a frame to the one above it."""

    parent: str
    times: npt.NDArray[np.float64]  # (K,) s
    poses: Poses  # (K, 4, 4) T_parent_child
    static: bool

    @cached_property
    def fixed(self) -> bool:
        """Whether it never moves."""
        return self.static or bool((abs(self.poses - self.poses[0]) <= STILL).all())

    def at(self, times: npt.NDArray[np.float64], source: str) -> tuple[Poses, dict[int, str]]:
        """As `poses_at`; what is static is so at all times."""
        if self.static:
            return np.tile(self.poses[-1], (len(times), 1, 1)), {}
        return poses_at(times, self.times, self.poses, source, np.inf if self.fixed else LONGEST_GAP)


class Frames:
    """The tree."""

    def __init__(self, source: str, links: dict[str, Link]) -> None:
        """links: by the frame that is below."""
        self.source, self.links = source, links

    @classmethod
    def of(cls, bag: Bag) -> "Frames":
        """All that a bag says of them. Raises ScanError; warns (MosWarning) where it says two things."""
        rows: dict[tuple[str, str, bool], array[float]] = defaultdict(lambda: array("d"))
        topics = tf_topics(bag)
        for topic in topics:
            static = topic.rpartition("/")[2] == STATIC
            for message in bag.messages(topic):
                for one in bag.decoded(message, bag.topics()[topic][0], f"{bag.path}: {topic}").transforms:
                    stamp, place, turn = one.header.stamp, one.transform.translation, one.transform.rotation
                    time = stamp.sec + 1e-9 * stamp.nanosec or 1e-9 * message.received
                    key = plain(one.child_frame_id), plain(one.header.frame_id), static
                    rows[key].extend((time, place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))
        links = dict[str, Link]()
        for (child, parent, static), values in sorted(rows.items(), key=lambda item: len(item[1])):
            if child in links:
                others = some(sorted({links[child].parent, parent}))
                warnings.warn(
                    f"{bag.path}: TF has {child} twice, below {others}; {parent} counts", MosWarning, stacklevel=2
                )
            table = np.frombuffer(values, np.float64).reshape(-1, 8)
            links[child] = Link(parent, table[:, 0], from_quaternions(table[:, 1:4], table[:, 4:]), static)
        return cls(f"{bag.path}: {' and '.join(topics)}", links)

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
        if len(chain) > 1 and (self._moving(chain) or any(_name(one) in WORLDS for one in chain)):
            return ""
        known = some(sorted({*self.links, *(link.parent for link in self.links.values())}), most=12) or "none"
        found = f"ends at {chain[-1]}, and nothing moves up to there" if len(chain) > 1 else "has nothing above it"
        return f"{self.source}: {chain[0]} {found}; there are the frames {known}"

    def world(self, frame: str) -> str:
        """In which the poses of a frame are: `odom`, or else the highest, above something that moves."""
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


def plain(frame: str) -> str:
    """A frame's name without the slash that ROS 1 once put before it."""
    return frame.lstrip("/")


def _name(frame: str) -> str:
    """Without the name of the robot before it."""
    return frame.rpartition("/")[2]
