"""Spherical projection of points to the pixels of a range image (paper, eq. 1)."""

import math

import numpy as np
from numpy.typing import NDArray

from runtime.compute.jit import fast_kernel, inlined
from runtime.sensors.range_image import RangeImage

BIN = 0.02  # degrees, width of the bins of elevation where rows follow a table
EXACT = 1 << 24  # pixels, or bins, that float32 counts
BLOCK = 512  # points whose pixels are computed at a time, in loops that vectorise


def pixel_scale(image: RangeImage) -> tuple[int, int, float, float, NDArray[np.int32]]:
    """What the kernels need of a range image: (bins, width, |fov_down| in rad, field of view in rad, row of each bin).

    Bins are equal angles from fov_up down. With a table of elevations they are narrow, and each belongs to the row of
    the nearest beam; without one they are the rows, and the last item is empty.
    """
    up, down = math.radians(image.fov_up), math.radians(image.fov_down)
    if not image.elevations:
        return image.height, image.width, -down, up - down, np.empty(0, np.int32)
    bins = min(math.ceil((image.fov_up - image.fov_down) / BIN), EXACT // image.width)
    centres = image.fov_up - (np.arange(bins) + 0.5) * ((image.fov_up - image.fov_down) / bins)  # degrees
    beams = np.array(image.elevations)
    rows = np.abs(centres[:, None] - beams).argmin(1).astype(np.int32)
    return bins, image.width, -down, up - down, rows


@inlined
def _angle(y, x):  # type: ignore[no-untyped-def]
    """atan2(y, x) in eighths of a turn: (whole, rest), whole + rest is the angle over pi / 4. Error < 2e-7.

    The caller scales both parts by its own factor; the whole part is exact, so that nothing is lost near +-pi.
    Polynomial: least-squares fit of 4 / pi * atan(t) / t in t^2 on [0, 1] at Chebyshev nodes.
    """
    ax = abs(x)
    ay = abs(y)
    big = max(ax, ay)
    small = min(ax, ay)
    t = small / big if big > np.float32(0) else np.float32(0)
    s = t * t
    p = np.float32(-0.002220149243844494)
    p = p * s + np.float32(0.013599114335084627)
    p = p * s + np.float32(-0.039110746996460784)
    p = p * s + np.float32(0.07316487417643003)
    p = p * s + np.float32(-0.10659642886277539)
    p = p * s + np.float32(0.13929493948484478)
    p = p * s + np.float32(-0.18158399579654938)
    p = p * s + np.float32(0.25462538076037045)
    p = p * s + np.float32(-0.4244125317446506)
    p = p * s + np.float32(1.2732395416106586)
    rest = p * t
    steep = ay > ax
    whole = np.float32(2) if steep else np.float32(0)
    rest = -rest if steep else rest
    behind = x < np.float32(0)
    whole = np.float32(4) - whole if behind else whole
    rest = -rest if behind else rest
    below = y < np.float32(0)
    whole = -whole if below else whole
    rest = -rest if below else rest
    return whole, rest


@fast_kernel
def project_block(points, transform, scale, xyz, pixel, distance):  # type: ignore[no-untyped-def]
    """Move points (n, >=3) f32 by `transform` (3, 4) f32 and project them.

    xyz (3, BLOCK) f32 is work space: coordinates side by side, which the loop over points needs to vectorise.
    Writes pixel[:n] int32 = v * width + u (-1: no direction, or not finite) and distance[:n] f32 in m (0 there).
    """
    bins, width, down, fov, rows = scale
    r00, r01, r02, tx = transform[0, 0], transform[0, 1], transform[0, 2], transform[0, 3]
    r10, r11, r12, ty = transform[1, 0], transform[1, 1], transform[1, 2], transform[1, 3]
    r20, r21, r22, tz = transform[2, 0], transform[2, 1], transform[2, 2], transform[2, 3]
    half = np.float32(0.5 * width)
    per_eighth = np.float32(width / 8)  # columns
    bins_per_eighth = np.float32(math.pi / 4 / fov * bins)
    top = np.float32((1 - down / fov) * bins)
    columns = np.float32(width)
    infinity = np.float32(np.inf)
    xs, ys, zs = xyz[0], xyz[1], xyz[2]
    for i in range(points.shape[0]):
        xs[i] = points[i, 0]
        ys[i] = points[i, 1]
        zs[i] = points[i, 2]
    for i in range(points.shape[0]):
        px, py, pz = xs[i], ys[i], zs[i]
        x = r00 * px + r01 * py + r02 * pz + tx
        y = r10 * px + r11 * py + r12 * pz + ty
        z = r20 * px + r21 * py + r22 * pz + tz
        flat = x * x + y * y
        r = np.sqrt(flat + z * z)
        valid = (r > np.float32(0)) & (r < infinity)
        whole, rest = _angle(y, x)
        u = (half - whole * per_eighth) - rest * per_eighth
        whole, rest = _angle(z, np.sqrt(flat))
        v = (top - whole * bins_per_eighth) - rest * bins_per_eighth
        u = min(max(np.floor(u), np.float32(0)), np.float32(width - 1))
        v = min(max(np.floor(v), np.float32(0)), np.float32(bins - 1))
        pixel[i] = np.int32(v * columns + u if valid else np.float32(-1))  # exact, see EXACT
        distance[i] = r if valid else np.float32(0)
    if rows.shape[0]:  # a loop of its own, for it looks up: the one above must vectorise
        for i in range(points.shape[0]):
            at = pixel[i]
            if at >= 0:
                line = at // width
                pixel[i] = at + (rows[line] - line) * width


@fast_kernel
def nearest_range(points, transform, scale, min_range, max_range, nearest):  # type: ignore[no-untyped-def]
    """Range image `nearest` (H * W) f32 m of moved points with min_range < r < max_range; infinity where empty."""
    xyz = np.empty((3, BLOCK), np.float32)
    pixel = np.empty(BLOCK, np.int32)
    distance = np.empty(BLOCK, np.float32)
    infinity = np.float32(np.inf)
    nearest[:] = infinity
    count = points.shape[0]
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        project_block(points[start:stop], transform, scale, xyz, pixel, distance)
        for i in range(stop - start):  # without branches, which no processor could foresee
            r = distance[i]
            r = r if (r > min_range) & (r < max_range) else infinity
            cell = max(pixel[i], 0)
            nearest[cell] = min(nearest[cell], r)


@fast_kernel
def project_scan(points, takes_part, scale, min_range, max_range, pixel, distance, first, nearest, limited):  # type: ignore[no-untyped-def]
    """Project the current scan, points (N, 4) f32, of which those with takes_part (N,) bool count.

    Writes for every point pixel (N,) int32 (-1: takes no part) and distance (N,) f32 m;
    for every pixel first (H * W) int32, the nearest point (-1: none), nearest (H * W) f32 m, its range (infinity:
    none), and limited, the same of only the points with min_range < r < max_range.
    """
    nearest[:] = np.float32(np.inf)
    limited[:] = np.float32(np.inf)
    first[:] = -1
    xyz = np.empty((3, BLOCK), np.float32)
    identity = np.zeros((3, 4), np.float32)
    identity[0, 0] = identity[1, 1] = identity[2, 2] = np.float32(1)
    count = points.shape[0]
    for start in range(0, count, BLOCK):
        stop = min(start + BLOCK, count)
        project_block(points[start:stop], identity, scale, xyz, pixel[start:stop], distance[start:stop])
        for i in range(start, stop):
            if not takes_part[i]:
                pixel[i], distance[i] = -1, np.float32(0)
            cell = pixel[i]
            if cell >= 0:
                r = distance[i]
                if r < nearest[cell]:
                    nearest[cell] = r
                    first[cell] = i
                if r > min_range and r < max_range and r < limited[cell]:
                    limited[cell] = r
