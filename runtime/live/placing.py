"""Where the poses of a session come from, which shows within its first seconds."""

import logging
import time

from runtime.errors import NoPosesError, PoseError
from runtime.live.pose_feed import PoseFeed
from runtime.recordings.poses import Pose

PATIENCE = 5.0  # s, for which the first poses are waited for

log = logging.getLogger("lidar_mos.recordings.live")


class Placing:
    """Gives each scan the pose that the system says, or leaves it to an odometry."""

    def __init__(self, feed: PoseFeed | None, needed: bool) -> None:
        """feed: None: an odometry finds all poses. needed: it may not."""
        self._feed, self._needed = feed, needed
        self._known = False
        self._began: float | None = None

    def pose(self, frame: str, seconds: float) -> Pose | None:
        """T_world_lidar (4, 4) of points in `frame` at a time in s; None: it is to be found.

        Raises PoseError where there is none for this scan, and NoPosesError where there will be none.
        """
        if self._feed is None:
            return None
        if not self._known:
            self._began = time.monotonic() if self._began is None else self._began
            if why := self._feed.missing(frame):
                if time.monotonic() - self._began < PATIENCE:
                    raise PoseError(why)
                self._give_up(why)
                return None
            self._known = True
            log.info("the poses are those of %s", self._feed.origin(frame))
        return self._feed.pose(frame, seconds)

    def _give_up(self, why: str) -> None:
        """No poses come. Raises NoPosesError where they are needed."""
        if self._needed:
            raise NoPosesError(f"no poses: {why}; name their topic (`pose_topic`), or find them (`odometry='kiss'`)")
        log.info("no poses come (%s): they are found by odometry", why)
        self._feed = None
