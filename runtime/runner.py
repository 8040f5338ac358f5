"""`MosRunner`: scan and pose in, a label for every point out."""

import logging
import warnings
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.belief.believers import choose_believer
from runtime.belief.delay import Delay
from runtime.belief.places import Places
from runtime.belief.result import MosResult
from runtime.bundle.choice import Choice, Chooser
from runtime.bundle.loading import Bundle, load_bundle
from runtime.bundle.manifest import SensorEntry
from runtime.bundle.residual import HISTORY
from runtime.compute.jit import is_cached
from runtime.compute.quota import available_processors
from runtime.compute.sessions import provider_name
from runtime.compute.stopwatch import Stopwatch
from runtime.compute.turns import Turns
from runtime.compute.undisturbed import undisturbed
from runtime.compute.workers import Workers
from runtime.doctor.watch import Look, Watch
from runtime.errors import InferenceError, MosWarning
from runtime.head.refiners import PointLabels
from runtime.head.stages import Stages
from runtime.image.entry import Entered
from runtime.image.history import History
from runtime.image.inputs import ImageInput
from runtime.image.precision import choose_precision
from runtime.image.projection import project_scan
from runtime.odometry.intake import Intake, Taken
from runtime.recordings.poses import Pose
from runtime.recordings.recording import Scan
from runtime.recordings.scans import check_scan
from runtime.settings import RunnerSettings

log = logging.getLogger("lidar_mos")

Arrived = tuple[Taken, Pose, Entered, str]  # what `MosRunner._enter` says of a scan


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
            What was chosen for "auto" is logged and in the attributes `precision`, `postprocess` and `belief`; the
            sensor in `sensor`. Where the first scan decides on that, memory is laid out anew for it.

        Raises BundleError, ProviderError or SettingError.
        """
        self.settings = (settings or RunnerSettings()).changed(changes)
        self.bundle: Bundle = load_bundle(bundle)
        manifest, given = self.bundle.manifest, self.settings
        self.workers = Workers(available_processors() if given.threads is None else given.threads)
        wanted = [provider_name(one) for one in given.providers or ()]
        self.precision, reason = choose_precision(self.bundle, given.precision, wanted)
        log.info("image network in %s: %s", self.precision, reason)
        if not is_cached(project_scan):
            log.warning("compiling kernels, once on this machine (20 to 60 s)")
        self._chooser = Chooser(manifest, given.profile)
        self._stages, self._doctor = self._lay_out(self._chooser.default)
        self._believer = choose_believer(given, self.postprocess, manifest, self._stages.choice.entry, self.workers)
        self._delay = Delay(given.delay, self._believer.judge, MosResult.with_labels)
        self._intake = Intake(given.odometry, given.deskew)
        self._scans, self._begun = 0, object()  # since `reset()`, and another with each
        self._history = History(manifest.tuned)
        self._closed = False
        self._turns = Turns()
        self._warm_up()

    @property
    def history_length(self) -> int:
        """Past scans that a result depends on."""
        return HISTORY + self._believer.horizon

    @property
    def belief(self) -> str:
        """What "auto" means here: "online" or "none"."""
        return "online" if self._believer.horizon else "none"

    @property
    def postprocess(self) -> str:
        """From pixels to points: "none", "knn" or "head"."""
        return self._stages.postprocess

    @property
    def sensor(self) -> SensorEntry | None:
        """The sensor that scans are taken for, with its range image and thresholds; None: the next scan decides."""
        return self._chooser.sensor

    def choose_sensor(self, scan: ArrayLike, ring: ArrayLike | None = None) -> SensorEntry | None:
        """Let this scan decide on the sensor, where none is given, as the first call does; None where it shows none.

        A sensor that is chosen stays until `reset()`. For recordings that are labelled from the middle on, and where
        the number of the laser of each point, ring (N,), is known.
        """
        with self._turns.alone():
            self._choose(check_scan(scan), ring)
            return self.sensor

    def reset(self, keep_sensor: bool = False) -> None:
        """Forget the history: the next scan is the first of a sequence, and decides on the sensor where it is to.

        Called while a scan is labelled, as from a handler of warnings, it makes that scan the first.
        """
        with self._turns.lock:
            undisturbed(partial(self._forget, keep_sensor))

    def flush(self) -> list[MosResult]:
        """The results that a delay still holds back, oldest first, by what is known up to now."""
        with self._turns.alone():
            return self._delay.flush()

    def close(self) -> None:
        """End the threads. A closed runner labels nothing any more."""
        with self._turns.lock:
            self._closed = True
            self.workers.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
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
        what an odometry has seen. Where a signal ends the call, the scan counts as a whole or not at all.
        """
        with self._turns.alone():
            return self._step(scan, pose, time, times)

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
        with self._turns.alone():
            if self._believer.horizon:
                self._step(scan, pose, time, times, wanted=False)
            else:
                arrived = self._enter(scan, pose, time, times)
                self._warn(None, arrived[-1])
                undisturbed(partial(self._remember, arrived))

    def _step(self, *given: Any, wanted: bool = True) -> MosResult | None:
        """Label a scan, remember it, and return the result that is due; wanted: its own will be."""
        watch = Stopwatch()
        taken, pose, entered, jump = arrived = self._enter(*given)
        past = [] if jump else self._history.past(pose)
        # Project and compare: the scan and its past, as the network sees them
        image = self._stages.inputs.build(entered, past)
        watch.lap("input")
        # Infer and refine: from pixels to points
        labels = self._label(entered, image, watch)
        # Believe: what other scans found and saw at these places
        seen = partial(self._stages.inputs.range_image, entered)
        labels, places = self._believer.believe(entered, pose, labels, seen, follows=bool(past))
        watch.lap("belief")
        # Remember
        shown = taken.data if self._stages.choice.mounting is None else entered.points
        look = self._doctor.look(shown, seen, past)
        begun = self._begun
        self._warn(look, jump)  # where warnings are errors, all stays as it was

        def remember() -> MosResult | None:
            index = self._remember(arrived, look if begun is self._begun else None, places)
            watch.lap("history")
            found = taken.pose.copy(), self._stages.choice.entry.name
            if wanted:
                result = MosResult(*labels, len(past) == HISTORY, watch.timing(), index, *found)
                self._delay.put(index, result, places)
            return self._delay.due(index) if wanted else None

        return undisturbed(remember)

    def _enter(self, scan: ArrayLike | Scan, *given: Any) -> Arrived:
        """The scan, the pose of its sensor, its points in a buffer, and in what it does not follow ("": it does)."""
        if self._closed:
            raise InferenceError("this runner is closed: make a new MosRunner")
        taken = self._intake.take(scan, *given)
        data = check_scan(taken.data)
        self._choose(data, scan.ring if isinstance(scan, Scan) else None)
        seen_from = self._stages.pose(taken.pose)
        jump = taken.lost or self._history.jump(seen_from, taken.time)
        return taken, seen_from, self._stages.inputs.enter(data), jump

    def _choose(self, scan: NDArray[np.floating], ring: ArrayLike | None = None) -> None:
        """Decide on the sensor by a scan, unless that is done."""
        choice = self._chooser.propose(scan, ring)
        if not self._stages.serve(choice):
            undisturbed(partial(self._change, *self._lay_out(choice)))
        self._chooser.keep(choice)

    def _change(self, stages: Stages, doctor: Watch) -> None:
        self._history.clear()  # of scans that showed nothing
        self._believer.serve(stages.choice.entry)
        self._stages, self._doctor = stages, doctor

    def _lay_out(self, choice: Choice) -> tuple[Stages, Watch]:
        """Make the stages for a sensor, with every kernel compiled or loaded."""
        stages = Stages.of(self.bundle, choice, self.settings, self.precision, self.workers)
        stages.refiner.warm_up()
        return stages, Watch(choice.entry.range_image)

    def _label(self, scan: Entered, image: ImageInput, watch: Stopwatch) -> PointLabels:
        """Infer, and refine."""
        if not scan.takes_part.any():
            watch.lap("network")
            labels = PointLabels(np.zeros(len(scan), np.bool_), np.zeros(len(scan), np.float32))
        else:
            seen = self._stages.network.run(image.image)
            watch.lap("network")
            labels = self._stages.refiner.refine(scan, image, seen)
        watch.lap("postprocess")
        return labels

    def _warn(self, look: Look | None, jump: str) -> None:
        dropped = [f"{jump}: the history of past scans is dropped"] if jump else []
        for text in (*(look.warnings if look else ()), *dropped):
            warnings.warn(text, MosWarning, stacklevel=4)

    def _forget(self, keep_sensor: bool) -> None:
        self._scans, self._begun = 0, object()
        for kept in (self._history, self._believer, self._delay):
            kept.clear()
        self._doctor.reset()
        self._intake.reset()
        if not keep_sensor:
            self._chooser.forget()

    def _remember(self, arrived: Arrived, look: Look | None = None, places: Places | None = None) -> int:
        """Its number since `reset()`."""
        taken, pose, entered, jump = arrived
        if jump:
            self._history.clear()
            self._delay.settle()
            self._believer.clear()
        if look:
            self._doctor.keep(look)
        self._intake.keep(taken)
        self._history.add(entered, pose, taken.time)
        self._believer.add(places)
        self._delay.reach(self._scans)
        self._scans += 1
        return self._scans - 1

    def _warm_up(self) -> None:
        """Compile or load the other kernels, and let ONNX Runtime lay out its memory."""
        grid = np.linspace(-1, 1, 16, dtype=np.float32)
        y, z = (a.reshape(-1) for a in np.meshgrid(grid, grid))
        wall = np.stack([np.full_like(y, 10), y, z, np.zeros_like(y)], axis=1)
        self.remember(wall, np.eye(4))
        self(wall, np.eye(4))
        self.reset()
