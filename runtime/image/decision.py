"""From probabilities to moving or not: of pixels, of the points in them, and of refined points."""

import numpy as np
from numpy.typing import NDArray

from runtime.classes import CLASSES, MOVING, STATIC, UNLABELLED
from runtime.compute.arguments import need, need_below
from runtime.compute.jit import inlined, kernel

_MOST_LIKELY = np.float32(-1)  # stands for a threshold that is None


def pixel_classes(probabilities: NDArray[np.float32], threshold: float | None) -> NDArray[np.uint8]:
    """Class (H, W) of probabilities (3, H, W): the most likely, or moving above a threshold, else static."""
    if threshold is None:
        best: NDArray[np.uint8] = probabilities.argmax(axis=0).astype(np.uint8)
        return best
    return np.where(probabilities[MOVING] > threshold, np.uint8(MOVING), np.uint8(STATIC))


def point_results(
    probabilities: NDArray[np.float32], pixel: NDArray[np.int32], threshold: float | None
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """What points take from their pixels: moving (N,), as by `pixel_classes`, and its probability (N,).

    `probabilities` (3, H, W) f32; `pixel` (N,) i32 v * W + u of each point, negative: none, which does not move.
    Raises ScanError where they do not fit.
    """
    need(probabilities, "probabilities", (len(CLASSES), None, None), np.float32)
    need(pixel, "pixel", (None,), np.int32)
    need_below(pixel, probabilities[0].size, "pixel")
    moving, probability = np.empty(len(pixel), np.bool_), np.empty(len(pixel), np.float32)
    _take(probabilities.reshape(len(CLASSES), -1), pixel, _number(threshold), moving, probability)
    return moving, probability


def take_refined(
    refined: NDArray[np.float32],
    threshold: float | None,
    moving: NDArray[np.bool_],
    probability: NDArray[np.float32],
) -> None:
    """Put the result of the points that were refined into `moving` (N,) and `probability` (N,).

    `refined` (N, 3), NaN for those that were not. Raises ScanError where they do not fit.
    """
    need(refined, "refined", (None, len(CLASSES)), np.float32)
    need(moving, "moving", (len(refined),), np.bool_)
    need(probability, "probability", (len(refined),), np.float32)
    _take_refined(refined, _number(threshold), moving, probability)


def _number(threshold: float | None) -> np.float32:
    return _MOST_LIKELY if threshold is None else np.float32(threshold)


@inlined
def _moves(unlabelled, static, moving, threshold):  # type: ignore[no-untyped-def]
    return moving > threshold if threshold >= 0 else moving > unlabelled and moving > static


@kernel
def _take(probabilities, pixel, threshold, moving, probability):  # type: ignore[no-untyped-def]
    for i in range(pixel.size):
        at = pixel[i]
        if at < 0:
            moving[i], probability[i] = False, np.float32(0)
        else:
            probability[i] = probabilities[MOVING, at]
            moving[i] = _moves(probabilities[UNLABELLED, at], probabilities[STATIC, at], probability[i], threshold)


@kernel
def _take_refined(refined, threshold, moving, probability):  # type: ignore[no-untyped-def]
    for i in range(refined.shape[0]):
        if not np.isnan(refined[i, MOVING]):
            probability[i] = refined[i, MOVING]
            moving[i] = _moves(refined[i, UNLABELLED], refined[i, STATIC], refined[i, MOVING], threshold)
