"""What integers cost: the IoU of moving against the float network, and the balance of its logit."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import expit, logit

from export.int8.scenes import Scene
from runtime.classes import MOVING, UNLABELLED
from runtime.compute.sessions import open_session
from runtime.evaluation.confusion import Confusion
from runtime.image.decision import pixel_classes

QUICK = 4  # scans on which single layers are judged
LARGEST_SHIFT = 1.0  # of the logit of moving
LEAST = 1e-7  # probability that is told from none


class Balance:
    """Keeps the mean probability of moving on `images` (1, channels, H, W) what it is in float.

    What integers and ReLUs lose moves the logits to one side, and with them the points above a threshold.
    """

    def __init__(self, float_model: bytes, images: Sequence[np.ndarray], threads: int) -> None:
        self.images, self.threads = images, threads
        self.wanted = float(self._probabilities(float_model).mean())

    def lacking(self, model: bytes) -> float:
        """What to add to the logit of moving that `model` computes, at most LARGEST_SHIFT up or down; two digits."""
        odds = logit(self._probabilities(model))

        def excess(shift: float) -> float:
            return float(expit(odds + shift).mean()) - self.wanted

        if excess(-LARGEST_SHIFT) >= 0 or excess(LARGEST_SHIFT) <= 0:
            return -LARGEST_SHIFT if excess(0) > 0 else LARGEST_SHIFT
        return round(float(brentq(excess, -LARGEST_SHIFT, LARGEST_SHIFT, xtol=1e-3)), 2)

    def _probabilities(self, model: bytes) -> np.ndarray:
        run = session(model, self.threads)
        found = np.concatenate([run(image)[MOVING].ravel() for image in self.images])
        return found.astype(np.float64).clip(LEAST, 1 - LEAST)


class Loss(NamedTuple):
    """INT8 against float."""

    before: float  # % IoU of the moving class in float
    after: float  # % in INT8
    difference: float  # mean |difference| of the probability of moving over labelled pixels

    @property
    def points(self) -> float:
        """Percentage points of IoU lost."""
        return self.before - self.after


class Judge:
    """Compares models with the float one on the same scenes."""

    def __init__(self, float_model: bytes, scenes: Sequence[Scene], threshold: float | None, threads: int) -> None:
        self.float_model, self.scenes, self.threshold, self.threads = float_model, scenes, threshold, threads

    def quick(self) -> "Judge":
        """The same on few scenes."""
        return Judge(self.float_model, self.scenes[:QUICK], self.threshold, self.threads)

    def loss(self, model: bytes) -> Loss:
        """What `model` loses."""
        run = session(model, self.threads)
        before, after, differences = Confusion(), Confusion(), []
        for scene, want in zip(self.scenes, self._wanted, strict=True):
            got = run(scene.image)
            before.add(scene.labels, pixel_classes(want, self.threshold))
            after.add(scene.labels, pixel_classes(got, self.threshold))
            differences.append(np.abs(got[MOVING] - want[MOVING])[scene.labels != UNLABELLED].mean())
        return Loss(_percent(before.iou), _percent(after.iou), float(np.mean(differences)))

    @cached_property
    def _wanted(self) -> list[np.ndarray]:
        run = session(self.float_model, self.threads)
        return [run(scene.image) for scene in self.scenes]


def _percent(share: float) -> float:
    return 0.0 if np.isnan(share) else 100 * share


def session(model: bytes, threads: int) -> Callable[[np.ndarray], np.ndarray]:
    """Probabilities (3, H, W) of an image (1, channels, H, W)."""
    loaded = open_session(model, threads=threads)
    return lambda image: loaded.run(["probabilities"], {"image": image})[0][0]
