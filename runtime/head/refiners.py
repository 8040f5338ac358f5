"""From the pixels of the image network to points: by themselves, by a vote, or by the point head."""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.loading import Bundle
from runtime.bundle.manifest import Decision, Tuned
from runtime.classes import MOVING
from runtime.compute.sessions import Execution
from runtime.compute.workers import Workers
from runtime.errors import SettingError
from runtime.head.onnx_engine import choose_head
from runtime.head.refinement import PointHead
from runtime.head.transfer import FeatureMap
from runtime.image.decision import pixel_classes, point_results, take_refined
from runtime.image.entry import Entered
from runtime.image.image_net import Seen
from runtime.image.inputs import ImageInput
from runtime.image.vote import knn_vote
from runtime.settings import RunnerSettings


class PointLabels(NamedTuple):
    """Of every point of a scan."""

    moving: NDArray[np.bool_]  # (N,)
    probability: NDArray[np.float32]  # (N,) that it moves


class Refiner(Protocol):
    """The last step of a scan."""

    def refine(self, scan: Entered, image: ImageInput, seen: Seen) -> PointLabels:
        """Labels of the points; those that take no part are not moving, with probability 0."""

    def warm_up(self) -> None:
        """Compile every kernel and lay out memory."""


class Pixels:
    """Points take the result of their pixel."""

    def __init__(self, decision: Decision) -> None:
        self._threshold = decision.threshold

    def refine(self, scan: Entered, image: ImageInput, seen: Seen) -> PointLabels:
        """See `Refiner`."""
        return PointLabels(*point_results(seen.probabilities, image.pixel, self._threshold))

    def warm_up(self) -> None:
        """See `Refiner`."""


class Vote(Pixels):
    """Points take the vote of near pixels; the probability stays that of their own (paper, Sec. III-D).

    Near by the distances from which pixels are seen: ranges, or from above the depths below the view's top.
    """

    def __init__(self, decision: Decision, workers: Workers) -> None:
        super().__init__(decision)
        self._workers = workers

    def refine(self, scan: Entered, image: ImageInput, seen: Seen) -> PointLabels:
        """See `Refiner`."""
        coarse = super().refine(scan, image, seen)
        classes = pixel_classes(seen.probabilities, self._threshold)
        labels = knn_vote(classes, image.nearest, image.pixel, image.distance, self._workers)
        return coarse._replace(moving=labels == MOVING)


class Head(Pixels):
    """The point head decides, around points that may move or everywhere (paper, Sec. III-D)."""

    def __init__(self, decision: Decision, head: PointHead, tuned: Tuned, everywhere: bool) -> None:
        super().__init__(decision)
        self.head, self._head_threshold = head, decision.head_threshold
        self._tuned, self._everywhere = tuned, everywhere

    def refine(self, scan: Entered, image: ImageInput, seen: Seen) -> PointLabels:
        """See `Refiner`."""
        moving, probability = super().refine(scan, image, seen)
        candidates = None if self._everywhere else probability > self._tuned.candidate
        features = FeatureMap(seen.features, image.pixel, image.image.shape[2])
        xyz = scan.points[:, :3]
        refined = self.head.refine(xyz, image.pixel >= 0, features, candidates, self._tuned.halo)
        take_refined(refined, self._head_threshold, moving, probability)
        return PointLabels(moving, probability)

    def warm_up(self) -> None:
        """See `Refiner`."""
        self.head.warm_up()


def choose_refiner(
    bundle: Bundle, decision: Decision, settings: RunnerSettings, workers: Workers, execution: Execution
) -> tuple[str, Refiner]:
    """What `settings.postprocess` names, or the bundle: "none", "knn" or "head", and what does it.

    decision: the thresholds, those of the sensor. execution: of the point head's ONNX engine, with the providers that
    could be started. Raises SettingError for what the bundle cannot have, and what `choose_head` raises.
    """
    manifest = bundle.manifest
    name = settings.postprocess or manifest.postprocess
    if name not in manifest.postprocesses:
        reason = "has no point head" if name == "head" else "sees points, not pixels that could vote"
        others = " or ".join(map(repr, reversed(manifest.postprocesses)))
        raise SettingError(f"bundle {manifest.name!r} {reason}: choose postprocess {others}")
    if name == "none":
        return name, Pixels(decision)
    if name == "knn":
        return name, Vote(decision, workers)
    head = choose_head(bundle, workers, settings.head_engine, execution)
    return name, Head(decision, head, manifest.tuned, settings.refine == "all")
