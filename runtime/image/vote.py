"""kNN post-processing, used by the paper for "v1": points take the vote of near cells of the image."""

import numpy as np
import numpy.typing as npt

from runtime.classes import MOVING, STATIC, UNLABELLED
from runtime.compute.arguments import need, need_below
from runtime.compute.jit import kernel
from runtime.compute.workers import Workers

WINDOW = 5  # pixels, side of the window around the point's pixel
NEIGHBOURS = 5  # cells that may vote
SIGMA = 1.0  # pixels
CUTOFF = 1.0  # m, weighted distance past which a cell does not vote

CENTRE = WINDOW * WINDOW // 2  # the centre's place in the order of the window
NOBODY = 1 << 60  # a vote that loses to every other and is for nobody

_GRAIN = 8192  # points that a thread takes at a time


def _weights() -> npt.NDArray[np.float32]:
    """1 - Gaussian over the window, the Gaussian normalised to sum 1: (WINDOW, WINDOW) float32."""
    offsets = np.arange(WINDOW) - WINDOW // 2
    gauss = np.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / (2 * SIGMA**2))
    weights: npt.NDArray[np.float32] = (1.0 - gauss / gauss.sum()).astype(np.float32)
    return weights


_WEIGHTS = _weights()


def knn_vote(
    labels: npt.NDArray[np.uint8],
    range_image: npt.NDArray[np.float32],
    pixel: npt.NDArray[np.int32],
    ranges: npt.NDArray[np.float32],
    workers: Workers,
) -> npt.NDArray[np.uint8]:
    """Class of every point, (N,) uint8: 1 static or 2 moving.

    labels: (H, W) class of each pixel (0 unlabelled, 1 static, 2 moving). range_image: (H, W) m, 0 where the
    pixel is empty. pixel: (N,) v * W + u of each point, negative: none. ranges: (N,) m, the points' own ranges.

    The cells of the 5 x 5 window are compared by |range of the cell - range of the point| * (1 - g), with g
    the normalised Gaussian of sigma 1. Empty pixels are infinitely far; cells outside the image have range 0
    and no label; the centre stands for the point itself. Of the 5 nearest (on equal distance the first in row
    order) those within 1 m vote. A tie, no vote at all, and a point without pixel are static.
    Raises ScanError where the arrays do not fit.
    """
    need(labels, "labels", (None, None), np.uint8)
    height, width = labels.shape
    need(range_image, "range_image", (height, width), np.float32)
    need(pixel, "pixel", (None,), np.int32)
    need(ranges, "ranges", (len(pixel),), np.float32)
    need_below(pixel, height * width, "pixel")
    cells = np.empty((height + WINDOW - 1, width + WINDOW - 1), np.float32)
    classes = np.empty(cells.shape, np.uint8)
    _pad(np.ascontiguousarray(labels), np.ascontiguousarray(range_image), cells, classes)
    pixel, ranges = np.ascontiguousarray(pixel), np.ascontiguousarray(ranges)
    out = np.empty(len(pixel), np.uint8)
    workers.ranges(
        lambda start, stop: _vote(cells, classes, pixel, width, ranges, _WEIGHTS, start, stop, out), len(out), _GRAIN
    )
    return out


@kernel
def _pad(labels, range_image, cells, classes):  # type: ignore[no-untyped-def]
    """Both images with a border of range 0 and no label; empty pixels infinitely far."""
    height, width = labels.shape
    half = WINDOW // 2
    cells[:] = 0
    classes[:] = UNLABELLED
    for y in range(height):
        for x in range(width):
            cell = range_image[y, x]
            cells[y + half, x + half] = cell if cell > 0 else np.inf
            classes[y + half, x + half] = labels[y, x]


@kernel
def _vote(cells, classes, pixel, width, ranges, weights, start, stop, out):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        out[i] = STATIC
        if pixel[i] < 0:
            continue
        top, left = divmod(np.uint32(pixel[i]), np.uint32(width))
        own = ranges[i]
        moving = 0
        for dy in range(np.uint32(WINDOW)):
            for dx in range(np.uint32(WINDOW)):
                moving += classes[top + dy, left + dx] == MOVING
        if moving == 0:  # nobody can vote for moving: true of most points
            continue

        # A vote is one integer: distance (the bits of a positive float rise with it), order in the window,
        # class. The five smallest so far stay sorted without a branch.
        first = second = third = fourth = fifth = NOBODY
        for dy in range(np.uint32(WINDOW)):
            for dx in range(np.uint32(WINDOW)):
                order = dy * WINDOW + dx
                cell = own if order == CENTRE else cells[top + dy, left + dx]
                distance = np.float32(abs(cell - own) * weights[dy, dx])
                label = classes[top + dy, left + dx]
                vote = np.int64(distance.view(np.int32)) << 8 | order << 2 | label
                vote = vote if distance <= CUTOFF else NOBODY
                first, vote = min(first, vote), max(first, vote)
                second, vote = min(second, vote), max(second, vote)
                third, vote = min(third, vote), max(third, vote)
                fourth, vote = min(fourth, vote), max(fourth, vote)
                fifth = min(fifth, vote)

        balance = 0
        for vote in (first, second, third, fourth, fifth):
            balance += (vote & 3 == MOVING) - (vote & 3 == STATIC)
        if balance > 0:
            out[i] = MOVING
