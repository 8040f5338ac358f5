"""Features on their way: image to voxels, voxels to points and back, and to the scan (paper, Sec. III-D)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from runtime.classes import CLASSES
from runtime.compute.arguments import need, need_below
from runtime.compute.jit import fast_kernel, kernel
from runtime.compute.workers import Workers
from runtime.errors import ScanError
from runtime.head.voxels import Voxels

_GRAIN = 1024  # voxels per task


class FeatureMap(NamedTuple):
    """Features of an image and the pixel of each point; only those of the voxels in question are read."""

    features: NDArray[np.float32]  # (c, H, W / s): s neighbouring pixels of a row share theirs
    pixel: NDArray[np.int32]  # (N,) v * W + u of each point, negative: no pixel (features are 0)
    width: int  # W


def features_to_voxels(
    given: FeatureMap, voxels: Voxels, mean: bool, out: NDArray[np.float32], workers: Workers
) -> NDArray[np.float32]:
    """Features of voxels: those of the voxel's first point in scan order, or the mean of all its points.

    `out` (V, >= c) float32, whose further columns become 0. Raises ScanError where they do not fit.
    """
    need(given.features, "features", (None, None, None), np.float32)
    channels, height, columns = given.features.shape
    if not columns or given.width % columns or given.width < columns:
        raise ScanError(f"an image {given.width} pixels wide has no features in {columns} columns")
    need(given.pixel, "pixel", (voxels.count,), np.int32)
    need_below(given.pixel, height * given.width, "pixel")
    need(out, "out", (len(voxels.keys), None), np.float32)
    if out.shape[1] < channels:
        raise ScanError(f"out must have {channels} columns or more, not {out.shape[1]}")
    table = given.features.reshape(len(given.features), -1)
    share = given.width // given.features.shape[2]
    order, starts, pick = voxels.order, voxels.starts, _mean_features if mean else _pick_features
    workers.ranges(lambda a, b: pick(table, given.pixel, share, order, starts, out, a, b), len(voxels.keys), _GRAIN)
    return out


def exchange(
    coarse: NDArray[np.float32],
    table: NDArray[np.int32],
    members: NDArray[np.int32],
    keys: NDArray[np.int64],
    level: int,
    points: NDArray[np.float32],
    out: NDArray[np.float32],
    workers: Workers,
) -> NDArray[np.float32]:
    """The point branch meets the voxels of stride 2^level: `points += v2p(coarse)`, then `out = p2v(points)`.

    v2p interpolates between the up to eight voxels around a point (a voxel sits at its lower corner; missing
    ones are dropped and the other weights divided by their sum); p2v is the mean over the points of a voxel.
    `coarse` and `out` (C, c), `table` (C + 1, 27) neighbours, `members` (C + 1,) first point of each coarse
    voxel, `keys` (V,) Morton keys of the points (one per voxel of stride 1), `points` (V, c), updated.
    Raises ScanError where the shapes do not fit.
    """
    rows, channels = coarse.shape
    need(table, "table", (rows + 1, 27), np.int32)
    need(members, "members", (rows + 1,), np.int32)
    need(points, "points", (len(keys), channels), np.float32)
    need(out, "out", (rows, channels), np.float32)
    grain = max(64, _GRAIN >> level)
    workers.ranges(lambda a, b: _exchange(coarse, table, members, keys, level, points, out, a, b), len(coarse), grain)
    return out


def classify(
    points: NDArray[np.float32],
    voxels: NDArray[np.float32],
    weight: NDArray[np.float32],
    bias: NDArray[np.float32],
    out: NDArray[np.float32],
    workers: Workers,
) -> NDArray[np.float32]:
    """`out = softmax((points + voxels) @ weight.T + bias)`; both (V, c), weight (3, <= c), out (V, 3).

    Raises ScanError where the shapes do not fit.
    """
    need(weight, "weight", (len(CLASSES), None), np.float32)
    need(bias, "bias", (len(CLASSES),), np.float32)
    need(points, "points", (len(out), None), np.float32)
    need(voxels, "voxels", points.shape, np.float32)
    need(out, "out", (len(out), len(CLASSES)), np.float32)
    if points.shape[1] < weight.shape[1]:
        raise ScanError(f"points must have {weight.shape[1]} channels or more, not {points.shape[1]}")
    workers.ranges(lambda a, b: _classify(points, voxels, weight, bias, out, a, b), len(out), _GRAIN)
    return out


@kernel
def _pick_features(table, pixel, share, order, starts, out, start, stop):  # type: ignore[no-untyped-def]
    """Copies blocks channel by channel: kind to the caches whichever of the table's axes comes first in memory."""
    channels = table.shape[0]
    block = np.empty((16, 1024), np.float32)
    for i in range(start, stop):
        for c in range(channels, out.shape[1]):
            out[i, c] = 0
    for low in range(start, stop, 1024):
        number = min(1024, stop - low)
        for group in range(0, channels, 16):
            width = min(16, channels - group)
            for c in range(width):
                for i in range(number):
                    at = pixel[order[starts[low + i]]]
                    block[c, i] = table[group + c, at // share] if at >= 0 else np.float32(0)
            for i in range(number):
                for c in range(width):
                    out[low + i, group + c] = block[c, i]


@kernel
def _mean_features(table, pixel, share, order, starts, out, start, stop):  # type: ignore[no-untyped-def]
    channels = table.shape[0]
    for v in range(start, stop):
        for channel in range(out.shape[1]):
            out[v, channel] = 0
        for i in range(starts[v], starts[v + 1]):
            at = pixel[order[i]]
            if at >= 0:
                for channel in range(channels):
                    out[v, channel] += table[channel, at // share]
        part = np.float32(1) / np.float32(starts[v + 1] - starts[v])
        for channel in range(channels):
            out[v, channel] *= part


@fast_kernel
def _exchange(coarse, table, members, keys, level, points, out, start, stop):  # type: ignore[no-untyped-def]
    none, channels = coarse.shape
    corners = np.empty(8, np.int64)
    weights = np.empty(8, np.float32)
    for c in range(start, stop):
        for corner in range(8):
            corners[corner] = table[c, 13 + (corner >> 2) + 3 * (corner >> 1 & 1) + 9 * (corner & 1)]
        for channel in range(channels):
            out[c, channel] = 0
        for v in range(members[c], members[c + 1]):
            x = y = z = np.float32(0)  # place in the coarse voxel, 0 <= x < 1
            for bit in range(level):
                octant = keys[v] >> 3 * bit
                size = np.float32(1.0 / (1 << (level - bit)))
                x += size * np.float32(octant >> 2 & 1)
                y += size * np.float32(octant >> 1 & 1)
                z += size * np.float32(octant & 1)
            total = np.float32(0)
            for corner in range(8):
                weight = x if corner & 4 else 1 - x
                weight *= y if corner & 2 else 1 - y
                weight *= z if corner & 1 else 1 - z
                weights[corner] = weight if corners[corner] < none else 0
                total += weights[corner]
            for corner in range(8):
                weight = weights[corner] / total
                if weight > 0:
                    row = corners[corner]
                    for channel in range(channels):
                        points[v, channel] += weight * coarse[row, channel]
            for channel in range(channels):
                out[c, channel] += points[v, channel]
        share = np.float32(1) / np.float32(members[c + 1] - members[c])
        for channel in range(channels):
            out[c, channel] *= share


@fast_kernel
def _classify(points, voxels, weight, bias, out, start, stop):  # type: ignore[no-untyped-def]
    channels = weight.shape[1]
    for v in range(start, stop):
        a, b, c = bias[0], bias[1], bias[2]
        for channel in range(channels):
            feature = points[v, channel] + voxels[v, channel]
            a += feature * weight[0, channel]
            b += feature * weight[1, channel]
            c += feature * weight[2, channel]
        highest = max(a, b, c)
        a, b, c = np.exp(a - highest), np.exp(b - highest), np.exp(c - highest)
        total = a + b + c
        out[v, 0] = a / total
        out[v, 1] = b / total
        out[v, 2] = c / total


@kernel
def to_points(probabilities, order, starts, wanted, out):  # type: ignore[no-untyped-def]
    """The points of voxel v take row v of the results (V, 3), if they are wanted; others keep their `out`."""
    for v in range(probabilities.shape[0]):
        for i in range(starts[v], starts[v + 1]):
            point = order[i]
            if wanted[point]:
                for j in range(3):
                    out[point, j] = probabilities[v, j]
