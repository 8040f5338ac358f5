"""`MosRunner`: scan and pose in, a label for every point out."""

import logging
import math
import threading
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.belief.believers import choose_believer
from runtime.belief.delay import Delay
from runtime.belief.places import Places
from runtime.bundle.loading import Bundle, load_bundle
from runtime.bundle.residual import HISTORY
from runtime.compute.jit import is_cached
from runtime.compute.quota import available_processors
from runtime.compute.sessions import provider_name
from runtime.compute.stopwatch import Stopwatch
from runtime.compute.workers import Workers
from runtime.doctor.watch import Look, Watch
from runtime.errors import InferenceError, MosWarning, SettingError
from runtime.head.refiners import PointLabels, choose_refiner
from runtime.image.entry import Entered
from runtime.image.history import History
from runtime.image.image_net import ImageNet
from runtime.image.inputs import ImageInput, InputBuilder
from runtime.image.precision import choose_precision
from runtime.image.projection import project_scan
from runtime.odometry.intake import Intake, Taken
from runtime.recordings.poses import Pose
from runtime.recordings.recording import Scan
from runtime.settings import RunnerSettings

log = logging.getLogger("lidar_mos")


@dataclass(frozen=True)
class MosResult:
    """Labels of one scan. The arrays are the caller's own."""

    moving: NDArray[np.bool_]  # (N,) the point belongs to something that moves
    probability: NDArray[np.float32]  # (N,) that it does: of the point head, or of the point's pixel without one
    ready: bool  # the history was full: all residual images had a scan
    timing: dict[str, float]  # s: "input", "network", "postprocess", "belief", "history", "total"
    index: int  # of the scan, counted since `reset()`
    pose: Pose  # (4, 4) T_world_lidar that the scan was taken to have


class MosRunner:
    """Moving-object segmentation, scan by scan (paper, Sec. III).

    State is the history of the last 8 scans and, with belief, what the last scans found at each place. Calls from
    several threads wait for each other; runners are independent.
    `with MosRunner() as runner:` ends its threads, as `close()` does.
    """

    def __init__(
        self, bundle: str | Path | None = None, *, settings: RunnerSettings | None = None, **changes: Any
    ) -> None:
        """Load a bundle, compile the kernels (once per machine) and warm up.

        bundle: folder of a bundle; None: the default one.
        settings: see `RunnerSettings`, whose fields may be given by name too: `MosRunner(threads=2, refine="all")`.
            What was chosen for "auto" is logged and in the attributes `precision`,
            `postprocess` and `belief`.

        Raises BundleError, ProviderError or SettingError.
        """
        self.settings = (settings or RunnerSettings()).changed(changes)
        self.bundle: Bundle = load_bundle(bundle)
        manifest, given = self.bundle.manifest, self.settings
        threads = available_processors() if given.threads is None else given.threads
        self.workers = Workers(threads)
        sensor = manifest.sensor
        self._inputs = InputBuilder(sensor.range_image, manifest.residual, self.workers, sensor.reach)
        wanted = list(given.providers or ())
        self.precision, reason = choose_precision(self.bundle, given.precision, [provider_name(one) for one in wanted])
        log.info("image network in %s: %s", self.precision, reason)
        self._image_net = ImageNet.of(
            self.bundle,
            precision=self.precision,
            threads=threads,
            providers=given.providers,
            allow_fallback=given.allow_fallback,
            session_options=given.session_options,
        )
        started = [one for one in wanted if provider_name(one) in self._image_net.providers]
        self.postprocess, self._refiner = choose_refiner(self.bundle, given, self.workers, started)
        self._believer = choose_believer(given, self.postprocess, manifest, self.workers)
        self._delay = Delay(given.delay, self._believer.judge, _with_labels)
        self._intake = Intake(given.odometry, given.deskew)
        self._scans = 0  # since `reset()`
        self._history = History(manifest.tuned)
        self._doctor = Watch(sensor.range_image)
        self._closed = False
        self._lock = threading.Lock()
        self._warm_up()

    @property
    def history_length(self) -> int:
        """Past scans that a result depends on."""
        return HISTORY + self._believer.horizon

    @property
    def belief(self) -> str:
        """What "auto" means here: "online" or "none"."""
        return "online" if self._believer.horizon else "none"

    def reset(self) -> None:
        """Forget the history: the next scan is the first of a sequence."""
        with self._lock:
            self._history.clear()
            self._believer.clear()
            self._delay.clear()
            self._doctor.reset()
            self._intake.reset()
            self._scans = 0

    def flush(self) -> list[MosResult]:
        """The results that a delay still holds back, oldest first, by what is known up to now."""
        with self._lock:
            return self._delay.flush()

    def close(self) -> None:
        """End the threads. A closed runner labels nothing any more."""
        with self._lock:
            self._closed = True
            self.workers.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __call__(
        self,
        scan: ArrayLike | Scan,
        pose: ArrayLike | None = None,
        time: float | None = None,
        times: ArrayLike | None = None,
    ) -> MosResult | Any:
        """Label the next scan of a sequence.

        With a delay the result is that of the scan so many calls before, and None until there is one. A jump makes
        those that wait final, and loses none; `flush()` returns them.

        scan: (N, 4) f32 or f64 x, y, z in m, LiDAR frame, and remission in 0..1; (N, 3), and remission that is not
            finite, take the mean remission that the network subtracts. Points at the origin, beyond the sensor's
            reach, or with a coordinate that is not finite, are never moving and have probability 0. Or a `Scan` of a
            recording, which brings the rest.
        pose: (4, 4) T_world_lidar, rigid; None: found by the setting `odometry`.
        time: s, to notice gaps; optional.
        times: (N,) s after `time` at which each point was measured, while the LiDAR moved on; optional. Then all are
            brought to the middle of the sweep, by the motion since the scan before.

        A jump of pose or time drops the history, with a MosWarning. What `mos doctor` calls bad about scans and poses
        (unit, remission, axes; poses of another frame or scale) is a MosWarning too, once a topic until `reset()`.
        Where the odometry is lost, the history is dropped in the same way.
        Raises ScanError, PoseError, SettingError (of the time) or InferenceError; the state is then as it was, but for
        what an odometry has seen.
        """
        with self._lock:
            result, places = self._step(scan, pose, time, times)
            self._delay.put(result.index, result, places)
            return self._delay.due(result.index)

    def remember(
        self,
        scan: ArrayLike | Scan,
        pose: ArrayLike | None = None,
        time: float | None = None,
        times: ArrayLike | None = None,
    ) -> None:
        """Put a scan into the history without a result, to go on in the middle of a sequence.

        With belief it is labelled all the same, since labels are what is believed.
        """
        with self._lock:
            if self._believer.horizon:
                self._step(scan, pose, time, times)
            else:
                self._pass(scan, pose, time, times)

    def _step(self, *given: Any) -> tuple[MosResult, Places | None]:
        """Label a scan and remember it."""
        watch = Stopwatch()
        taken, entered, jump = self._enter(*given)
        past = [] if jump else self._history.past(taken.pose)
        # Project and compare: the range image and its residuals
        projected = self._inputs.project(entered, past)
        image = self._inputs.residuals(projected, past)
        watch.lap("input")
        # Infer and refine: from pixels to points
        labels = self._label(entered, image, watch)
        # Believe: what the last scans found at these places
        labels, places = self._believer.believe(entered, taken.pose, labels, follows=bool(past))
        watch.lap("belief")
        # Remember
        look = self._doctor.look(taken.data, image, past)
        index = self._remember(taken, entered, jump, look, places)
        watch.lap("history")
        return MosResult(*labels, len(past) == HISTORY, watch.timing(), index, taken.pose.copy()), places

    def _pass(self, *given: Any) -> None:
        """Remember a scan without labelling it."""
        self._remember(*self._enter(*given))

    def _enter(
        self, scan: ArrayLike | Scan, pose: ArrayLike | None, time: float | None, times: ArrayLike | None
    ) -> tuple[Taken, Entered, str]:
        """The scan with its pose, its points in a buffer of this runner, and in what it follows none ("": it does)."""
        if self._closed:
            raise InferenceError("this runner is closed: make a new MosRunner")
        _check_time(time)
        taken = self._intake.take(scan, pose, time, times)
        entered = self._inputs.enter(taken.data)
        return taken, entered, taken.lost or self._history.jump(taken.pose, taken.time)

    def _label(self, scan: Entered, image: ImageInput, watch: Stopwatch) -> PointLabels:
        """Infer, and refine."""
        if not scan.takes_part.any():
            watch.lap("network")
            labels = PointLabels(np.zeros(len(scan), np.bool_), np.zeros(len(scan), np.float32))
        else:
            seen = self._image_net.run(image.image)
            watch.lap("network")
            labels = self._refiner.refine(scan, image, seen)
        watch.lap("postprocess")
        return labels

    def _remember(
        self,
        taken: Taken,
        entered: Entered,
        jump: str,
        look: Look | None = None,
        places: Places | None = None,
    ) -> int:
        """Its number since `reset()`. Warns first: where warnings are errors, all stays as it was."""
        for text in look.warnings if look else ():
            warnings.warn(text, MosWarning, stacklevel=4)
        if jump:
            warnings.warn(f"{jump}: the history of past scans is dropped", MosWarning, stacklevel=4)
            self._history.clear()
            self._delay.settle()
            self._believer.clear()
        if look:
            self._doctor.keep(look)
        self._intake.keep(taken)
        self._history.add(entered, taken.pose, taken.time)
        self._believer.add(places)
        self._delay.reach(self._scans)
        self._scans += 1
        return self._scans - 1

    def _warm_up(self) -> None:
        """Compile or load every kernel, and let ONNX Runtime and the point head lay out their memory."""
        if not is_cached(project_scan):
            log.warning("compiling kernels, once on this machine (20 to 60 s)")
        grid = np.linspace(-1, 1, 16, dtype=np.float32)
        y, z = (a.reshape(-1) for a in np.meshgrid(grid, grid))
        wall = np.stack([np.full_like(y, 10), y, z, np.zeros_like(y)], axis=1)
        self.remember(wall, np.eye(4))
        self(wall, np.eye(4))
        self.reset()
        self._refiner.warm_up()


def _with_labels(result: MosResult, labels: PointLabels) -> MosResult:
    return replace(result, moving=labels.moving, probability=labels.probability)


def _check_time(time: float | None) -> None:
    """Raise SettingError unless `time` is a number of seconds or None."""
    try:
        known = time is None or math.isfinite(time)
    except (TypeError, OverflowError):
        known = False
    if not known:
        raise SettingError(f"time must be a number of seconds, or None, not {time!r}")
