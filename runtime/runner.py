"""`MosRunner`: scan and pose in, a label for every point out."""

import logging
import math
import threading
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from runtime.bundle.manifest import POSTPROCESSES, Bundle, load_bundle
from runtime.bundle.residual import HISTORY
from runtime.classes import MOVING
from runtime.compute.jit import is_cached
from runtime.compute.quota import available_processors
from runtime.compute.sessions import provider_name
from runtime.compute.workers import Workers
from runtime.errors import MosWarning, SettingError
from runtime.head.onnx_engine import ENGINES, choose_head
from runtime.head.refinement import PointHead
from runtime.head.transfer import FeatureMap
from runtime.image.decision import pixel_classes, point_results, take_refined
from runtime.image.history import History
from runtime.image.image_net import ImageNet
from runtime.image.inputs import ImageInput, InputBuilder
from runtime.image.precision import choose_precision
from runtime.image.projection import project_scan
from runtime.image.vote import knn_vote
from runtime.recordings.poses import check_pose
from runtime.recordings.scans import as_scan

log = logging.getLogger("lidar_mos")

# Median residual of the oldest scan from which poses are doubted, and in how many scans in a row. With right poses it
# is 0.01, and 0.06 at most in 120 simulated scans; on the real drive 1.2 with a camera's and 0.15 with inverted ones.
MISFIT = 0.1
DOUBTS = 5
CANDIDATE = 0.2  # probability of its pixel from which a point may move: the point head looks at its surroundings


@dataclass(frozen=True)
class MosResult:
    """Labels of one scan. The arrays are the caller's own."""

    moving: NDArray[np.bool_]  # (N,) the point belongs to something that moves
    probability: NDArray[np.float32]  # (N,) that it does: of the point head, or of the point's pixel without one
    ready: bool  # the history was full: all residual images had a scan
    timing: dict[str, float]  # s: "input", "network", "postprocess", "history", "total"


class MosRunner:
    """Moving-object segmentation, scan by scan (paper, Sec. III).

    State is the history of the last 8 scans. Calls from several threads wait for each other; runners are independent.
    """

    def __init__(
        self,
        bundle: str | Path | None = None,
        *,
        threads: int | None = None,
        postprocess: Literal["none", "knn", "head"] | None = None,
        refine: Literal["near", "all"] = "near",
        head_engine: Literal["auto", "numba", "onnx"] = "auto",
        precision: str = "auto",
        providers: Sequence[Any] | None = None,
        allow_fallback: bool = False,
        session_options: Mapping[str, str] | None = None,
    ) -> None:
        """Load a bundle, compile the kernels (once per machine) and warm up.

        bundle: folder of a bundle; None: the default one.
        threads: of the kernels and of ONNX Runtime; None: all processors that this process may use.
        postprocess: "head" refines points by the point head, "knn" lets them vote, "none" takes their pixel's result;
            None: what the bundle says.
        refine: the point head looks "near" points that may move (the others keep their pixel's result), or at "all".
        head_engine: of the point head: "numba" on the processor, "onnx" on `providers`; "auto": "onnx" on a GPU's
            provider where the bundle has `point_head.onnx`, else "numba".
        precision: of the image network: "float32", "int8", or "auto": INT8 where the bundle has it and the processor
            gains from it (`runtime.image.precision`); what was chosen is logged and in the attribute `precision`.
        providers, allow_fallback, session_options: see `runtime.compute.sessions.open_session`.

        Raises BundleError, ProviderError or SettingError.
        """
        self.bundle: Bundle = load_bundle(bundle)
        manifest = self.bundle.manifest
        if threads is None:
            threads = available_processors()
        self.workers = Workers(threads)
        self.postprocess: str = manifest.postprocess if postprocess is None else postprocess
        if self.postprocess not in POSTPROCESSES:
            raise SettingError(f"postprocess must be one of {', '.join(POSTPROCESSES)}, not {self.postprocess!r}")
        if refine not in ("near", "all"):
            raise SettingError(f"refine must be 'near' or 'all', not {refine!r}")
        if self.postprocess == "head" and manifest.point_head is None:
            raise SettingError(f"bundle {manifest.name!r} has no point head: choose postprocess 'knn' or 'none'")
        if head_engine not in ENGINES:
            raise SettingError(f"head_engine must be one of {', '.join(ENGINES)}, not {head_engine!r}")
        if isinstance(providers, str):
            raise SettingError(f"providers must be a list of names, as [{providers!r}]")
        self.refine = refine
        self._inputs = InputBuilder(manifest.sensor, manifest.residual, self.workers)
        names = [provider_name(given) for given in providers or ()]
        self.precision, reason = choose_precision(self.bundle, precision, names)
        log.info("image network in %s: %s", self.precision, reason)
        self._image_net = ImageNet.of(
            self.bundle,
            precision=self.precision,
            threads=threads,
            providers=providers,
            allow_fallback=allow_fallback,
            session_options=session_options,
        )
        self._head: PointHead | None = None
        if self.postprocess == "head":
            started = [given for given in providers or () if provider_name(given) in self._image_net.providers]
            self._head = choose_head(self.bundle, self.workers, head_engine, started, session_options=session_options)
        self._history = History()
        self._misfits = 0  # scans in a row whose surroundings do not fall together with those of the past
        self._points = np.empty((0, 4), np.float32)
        self._lock = threading.Lock()
        self._warm_up()

    @property
    def history_length(self) -> int:
        """Past scans that a result depends on."""
        return HISTORY

    def reset(self) -> None:
        """Forget the history: the next scan is the first of a sequence."""
        with self._lock:
            self._history.clear()
            self._misfits = 0

    def __call__(self, scan: ArrayLike, pose: ArrayLike, time: float | None = None) -> MosResult:
        """Label the next scan of a sequence.

        scan: (N, 4) f32 or f64 x, y, z in m, LiDAR frame, and remission in 0..1; (N, 3) takes the mean remission that
            the network subtracts. Points at the origin, or with a value that is not finite, are never moving and have
            probability 0.
        pose: (4, 4) T_world_lidar, rigid.
        time: s, to notice gaps; optional.

        A jump of pose or time drops the history, with a MosWarning. Another one says once if the surroundings do not
        fall together under the poses: a wrong frame, no poses at all. Raises ScanError, PoseError, SettingError (of the
        time) or InferenceError; the history is then as it was.
        """
        with self._lock:
            started = perf_counter()
            points, pose = self._accept(scan, pose, time)
            jump = self._history.jump(pose, time)
            past, relative = ([], []) if jump else (self._history.past(), self._history.relative(pose))
            image = self._inputs.build(points, past, relative)
            built = perf_counter()
            if (image.pixel >= 0).any():
                probabilities, features = self._image_net.run(image.image)
                inferred = perf_counter()
                moving, probability = self._to_points(image, points, probabilities, features)
            else:
                inferred = built
                moving, probability = np.zeros(len(points), np.bool_), np.zeros(len(points), np.float32)
            labelled = perf_counter()
            misfits = self._misfits + 1 if len(past) == HISTORY and _misfit(image) > MISFIT else 0
            self._remember(points, image.pixel >= 0, pose, time, jump, misfits)
            done = perf_counter()
        timing = {
            "input": built - started,
            "network": inferred - built,
            "postprocess": labelled - inferred,
            "history": done - labelled,
            "total": done - started,
        }
        return MosResult(moving, probability, len(past) == HISTORY, timing)

    def remember(self, scan: ArrayLike, pose: ArrayLike, time: float | None = None) -> None:
        """Put a scan into the history without labelling it, to go on in the middle of a sequence."""
        with self._lock:
            points, pose = self._accept(scan, pose, time)
            keep = np.logical_and(np.isfinite(points).all(axis=1), points[:, :3].any(axis=1))
            self._remember(points, keep, pose, time, self._history.jump(pose, time))

    def _accept(
        self, scan: ArrayLike, pose: ArrayLike, time: float | None
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Scan (N, 4), in a buffer of this runner, and pose (4, 4); all three are checked."""
        try:
            known = time is None or math.isfinite(time)
        except (TypeError, OverflowError):
            known = False
        if not known:
            raise SettingError(f"time must be a number of seconds, or None, not {time!r}")
        given = as_scan(scan, remission_fill=self.bundle.manifest.sensor.mean[4])
        checked = check_pose(pose, "pose")
        if len(self._points) < len(given):
            self._points = np.empty((len(given) + len(given) // 8, 4), np.float32)
        points = self._points[: len(given)]
        points[:] = given
        return points, checked

    def _remember(
        self,
        points: NDArray[np.float32],
        keep: NDArray[np.bool_],
        pose: NDArray[np.float64],
        time: float | None,
        jump: str,
        misfits: int = 0,
    ) -> None:
        self._misfits = misfits
        if misfits == DOUBTS:  # where warnings are errors, the history stays as it was
            text = (
                f"under these poses the surroundings of {HISTORY} scans ago lie elsewhere, and standing things seem to "
                "move. Are they T_world_lidar, not a camera's, not inverted? `mos doctor` looks into recordings"
            )
            warnings.warn(text, MosWarning, stacklevel=3)
        if jump:
            warnings.warn(f"{jump}: the history of past scans is dropped", MosWarning, stacklevel=3)
            self._history.clear()
        self._history.add(points, keep, pose, time)

    def _to_points(
        self,
        image: ImageInput,
        points: NDArray[np.float32],
        probabilities: NDArray[np.float32],
        features: NDArray[np.float32],
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """From pixels to points: moving (N,), probability (N,)."""
        decision = self.bundle.manifest.decision
        moving, probability = point_results(probabilities, image.pixel, decision.threshold)
        if self.postprocess == "knn":
            classes = pixel_classes(probabilities, decision.threshold)
            labels = knn_vote(classes, image.range_image, image.pixel, image.range, self.workers)
            return labels == MOVING, probability
        if self._head is not None:
            candidates = None if self.refine == "all" else probability > CANDIDATE
            given = FeatureMap(features, image.pixel, image.image.shape[2])
            refined = self._head.refine(points[:, :3], image.pixel >= 0, given, candidates)
            take_refined(refined, decision.head_threshold, moving, probability)
        return moving, probability

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
        if self._head is not None:
            self._head.warm_up()


def _misfit(image: ImageInput) -> float:
    """Median size of the oldest residual image, over every 32nd of the pixels that both scans saw."""
    residual = np.abs(image.image[-1, ::4, ::8])
    seen = residual[residual > 0]
    return float(np.median(seen)) if seen.size else 0.0
