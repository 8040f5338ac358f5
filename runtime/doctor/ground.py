"""The ground that a sensor stands on: found as the plane that most near points lie on and hardly any below."""

from dataclasses import dataclass
from functools import cache
from math import atan2, degrees, hypot

import numpy as np
import numpy.typing as npt

from runtime.compute.jit import fast_kernel

POINTS = 512  # of the nearer half of a scan that are looked at
PLANES = 256  # through three of them each; a ground with a sixth of the points is hit once at least, nearly always
THICKNESS = 0.01  # of the median range: distance within which a point lies on a plane, whatever the unit of length
STEEP = 0.1  # height over the mean range of its points, at least; of the rings of nearly level beams it is less
FLAT = 0.4  # height over the median range, at most, unless below: a ground is seen at a flat angle, a ceiling is not
LEAST = 0.1  # share of the near points on a ground; streets have 0.3 and more, between high houses 0.15
BELOW = 0.94  # cosine of the tilt, 20 degrees, up to which a plane lies below
PREFERRED = 4  # times its share that a plane below counts: between houses the walls have more points


@dataclass(frozen=True)
class Ground:
    """A large plane that everything else lies on one side of."""

    height: float  # of the sensor over it, in the unit of the points
    pitch: float  # degrees by which the sensor looks up, -180..180
    roll: float  # degrees by which it leans to the right, -180..180
    tilt: float  # degrees between its z axis and the plane's upright, 0..180; 180 is upside down
    support: float  # share of the near points that lie on the plane, less twice that of those behind it


def find_ground(points: npt.NDArray[np.float32], ranges: npt.NDArray[np.float32], middle: float) -> Ground | None:
    """The largest plane under (or, upside down, above or beside) the sensor, at the origin; None without a large one.

    points: (N, 3) f32 usable points of a scan, a thousand are plenty; ranges: (N,), and middle: their median.
    """
    near = np.flatnonzero(ranges <= middle)
    if len(near) == 0:
        return None
    numbers = near[np.linspace(0, len(near) - 1, POINTS).astype(np.intp)]
    chosen = np.ascontiguousarray(points[numbers].T)
    planes = np.empty((PLANES, 5), np.float32)
    thick = np.float32(THICKNESS * middle)
    _measure(chosen, ranges[numbers], _triples(), thick, planes)
    elsewhere = np.where(planes[:, 3] <= FLAT * middle, 1, 0)
    best = planes[np.argmax(planes[:, 4] * np.where(planes[:, 2] > BELOW, PREFERRED, elsewhere))]
    if best[4] < LEAST:
        return None
    normal, height = _refine(chosen, best, thick)
    x, y, z = normal
    return Ground(height, degrees(atan2(x, z)), degrees(atan2(y, z)), degrees(atan2(hypot(x, y), z)), float(best[4]))


@cache
def _triples() -> npt.NDArray[np.intp]:
    """(PLANES, 3) numbers of points, always the same."""
    return np.random.default_rng(0).integers(0, POINTS, (PLANES, 3))


def _refine(
    points: npt.NDArray[np.float32], plane: npt.NDArray[np.float32], thick: np.float32
) -> tuple[npt.NDArray[np.float64], float]:
    """Unit normal towards the sensor and distance of the plane that fits the points (3, N) on `plane` best."""
    on = points[:, np.abs(plane[:3] @ points + plane[3]) < thick].astype(np.float64)
    centre = on.mean(1)
    normal = np.linalg.eigh(np.cov(on))[1][:, 0]
    distance = -float(normal @ centre)
    return (normal, distance) if distance >= 0 else (-normal, -distance)


@fast_kernel
def _measure(points, ranges, triples, thick, planes):  # type: ignore[no-untyped-def]
    """Planes (P, 5) f32 through triples of the points (3, N) f32: unit normal towards the origin, distance from it,
    and share of the points within `thick` less twice that of the points well behind."""
    xs, ys, zs = points[0], points[1], points[2]
    count = xs.size
    one = np.float32(1)
    none = np.float32(0)
    for p in range(triples.shape[0]):
        a, b, c = triples[p, 0], triples[p, 1], triples[p, 2]
        ux, uy, uz = xs[b] - xs[a], ys[b] - ys[a], zs[b] - zs[a]
        vx, vy, vz = xs[c] - xs[a], ys[c] - ys[a], zs[c] - zs[a]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if not length > np.float32(100) * thick * thick:  # points in a line, or too close together
            planes[p] = none
            continue
        length = -length if nx * xs[a] + ny * ys[a] + nz * zs[a] > none else length
        nx, ny, nz = nx / length, ny / length, nz / length
        distance = -(nx * xs[a] + ny * ys[a] + nz * zs[a])
        on, behind, far = none, none, none
        for i in range(count):
            height = nx * xs[i] + ny * ys[i] + nz * zs[i] + distance
            on += one if abs(height) < thick else none
            far += ranges[i] if abs(height) < thick else none
            behind += one if height < np.float32(-3) * thick else none
        planes[p, 0], planes[p, 1], planes[p, 2], planes[p, 3] = nx, ny, nz, distance
        steep = distance * on >= np.float32(STEEP) * far
        planes[p, 4] = (on - np.float32(2) * behind) / np.float32(count) if steep else none
