"""Are the points those of one LiDAR as it measured them, or of several, or thinned out, or moved?"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import numpy.typing as npt

from runtime.compute.jit import kernel
from runtime.doctor.findings import Finding
from runtime.doctor.sample import middle
from runtime.errors import MosError
from runtime.recordings.recording import Indexed, Scan

SCANS = 3  # that are looked at
FEWEST = 200  # points of a kind that tell anything
NEAR, FAR = (1.0, 8.0), (15.0, 30.0)  # m of range
# A turning LiDAR's points lie the closer the nearer they are: of 11 real sensors 13 to 30 mm from point to point when
# NEAR, 0.13 to 0.39 of that when FAR. Voxels of 0.1 m leave 51 to 72 mm and 0.41 to 0.71, larger ones more.
CLOSE, GROWTH = 0.045, 0.4
LEAST_RANGE = 10.0  # m, from which on a beam's elevation is looked at: the lasers of a sensor are up to 20 cm apart
SPREAD = 1.0  # degrees of one laser's elevations: 0 to 0.15 as measured, 0.5 to 10 seen from elsewhere
QUERIES = 1000  # points whose neighbours are looked for

Points = npt.NDArray[np.float32]  # (N, 3)


def check_cloud(recording: Indexed) -> list[Finding]:
    """What is bad about the clouds of a recording; those that cannot be read tell nothing."""
    scans = []
    for index in np.unique(np.linspace(0, len(recording) - 1, SCANS).round().astype(int)):
        with suppress(MosError):
            scans.append(recording.read(int(index)))
    return [found for found in (_check_thinned(scans), _check_origin(scans)) if found]


def _check_thinned(scans: Sequence[Scan]) -> Finding | None:
    """By how far it is from a point to the next, near and far."""
    known = [pair for scan in scans if (pair := _spacing(scan.points))]
    if not known:
        return None
    near, far = middle(near for near, _ in known), middle(far for _, far in known)
    if near < CLOSE or near < GROWTH * far:
        return None
    return Finding(
        "bad",
        "thinning",
        f"points are {100 * near:.0f} cm apart, near as far: that looks like a voxel filter, behind which the network "
        f"sees gaps; give the points as the sensor measured them",
    )


def _spacing(points: Points) -> tuple[float, float] | None:
    """Median distance in m from a point to the nearest other one, near and far; None where hardly any are there."""
    ranges = np.linalg.norm(points, axis=1)
    found = []
    for low, high in (NEAR, FAR):
        within = points[(ranges > low) & (ranges < high)]
        if len(within) < FEWEST:
            return None
        found.append(float(np.median(_to_the_next(within, max(1, len(within) // QUERIES)))))
    return found[0], found[1]


@kernel
def _to_the_next(points, step):  # type: ignore[no-untyped-def]
    """Distance in m from every `step`-th of the points (N, 3) to the nearest other one."""
    found = np.empty((points.shape[0] + step - 1) // step, np.float32)
    for k in range(found.size):
        i, nearest = k * step, np.float32(np.inf)
        for j in range(points.shape[0]):
            x, y, z = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            away = x * x + y * y + z * z
            if away < nearest and j != i:
                nearest = away
        found[k] = np.sqrt(nearest)
    return found


def _check_origin(scans: Sequence[Scan]) -> Finding | None:
    """By the elevations of each laser's points, which are all the same as seen from where they were measured."""
    known = [spread for scan in scans if (spread := _spread(scan)) is not None]
    if not known or (spread := middle(known)) < SPREAD:
        return None
    return Finding(
        "bad",
        "origin",
        f"the points of one laser are seen over {spread:.1f} degrees of elevation, not under one: they were measured "
        f"from elsewhere than the origin, by several LiDARs or in the frame of the vehicle; give those of one LiDAR, "
        f"in its own frame",
    )


def _spread(scan: Scan) -> float | None:
    """Degrees from the lowest to the highest tenth of a laser's elevations, of the middle laser; None if unknown."""
    if scan.ring is None or not len(scan.ring):
        return None
    ranges = np.linalg.norm(scan.points, axis=1)
    use = np.isfinite(ranges) & (ranges > LEAST_RANGE)
    elevations = np.degrees(np.arcsin(scan.points[use, 2] / ranges[use]))
    spreads = []
    for ring in np.unique(scan.ring[use]):
        one = elevations[scan.ring[use] == ring]
        if len(one) >= FEWEST // 4:
            low, high = np.quantile(one, [0.1, 0.9])
            spreads.append(float(high - low))
    return middle(spreads) if len(spreads) > 1 else None
