"""Do scans hold what the network expects: metres, finite points, remission in 0..1, the field of view?"""

import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from runtime.doctor.findings import Finding, percent
from runtime.errors import MosError, some
from runtime.recordings.recording import Indexed
from runtime.recordings.scans import ScanData
from runtime.sensors.range_image import RangeImage

SECTORS = 719  # of half a degree, in each of which a beam leaves points of nearly one elevation; odd, so that their
# edges do not fall on the columns of a sensor
BEAM_GAP = 0.1  # degrees between neighbouring beams, at least
OTHER = "use a bundle made for your sensor"
BEAMS = (16, 32, 40, 64, 80, 128)  # that sensors have


@dataclass(frozen=True)
class Samples:
    """The points of some scans of a recording. From `ranges` on: only finite points not at the origin."""

    scans: int
    points: int
    infinite: float  # share of points with NaN or infinity in x, y, z or remission
    origin: float  # share of points at the origin
    ranges: npt.NDArray[np.float64]  # (M,) m
    elevations: npt.NDArray[np.float64]  # (M,) degrees
    remissions: npt.NDArray[np.float64]  # (M,)
    beams: int  # of a scan of median size, as far as can be told

    @classmethod
    def of(cls, scans: list[ScanData]) -> "Samples":
        xyz = np.concatenate([scan[:, :3] for scan in scans]).astype(np.float64)
        remission = np.concatenate([scan[:, 3:].sum(1) for scan in scans]).astype(np.float64)  # 0 where there is none
        finite = np.isfinite(xyz).all(1) & np.isfinite(remission)
        origin = (xyz == 0).all(1)
        points = xyz[finite & ~origin]
        ranges, elevations = _polar(points)
        return cls(
            scans=len(scans),
            points=len(xyz),
            infinite=float((~finite).mean()) if len(xyz) else 0.0,
            origin=float(origin.mean()) if len(xyz) else 0.0,
            ranges=ranges,
            elevations=elevations,
            remissions=remission[finite & ~origin],
            beams=count_beams(sorted(scans, key=len)[len(scans) // 2]),
        )


def check_files(recording: Indexed) -> list[Finding]:
    """Numbering and sizes of all scans."""
    found = []
    keys = recording.keys
    numbers = [number for key in keys if (number := scan_number(key)) is not None]
    steps = np.diff(numbers)
    gaps = [f"{a} to {b}" for a, b in pairwise(numbers) if b - a > np.median(steps)]
    if gaps and len(numbers) == len(keys) and max(steps) < 1e6:
        found.append(Finding("warn", "scans", f"file names jump from {some(gaps)}: scans are missing there"))
    sizes: dict[str, int] = {}
    broken: dict[str, str] = {}
    for index, key in enumerate(keys):
        try:
            sizes[key] = recording.count(index)
        except MosError as error:
            broken[key] = str(error)
    if broken:
        first, *others = broken
        more = f" (and {len(others)} more: {some(others)})" if others else ""
        found.append(Finding("bad", "scans", f"{broken[first]}{more}"))
    usual = np.median(list(sizes.values())) if sizes else 0
    empty = [name for name, size in sizes.items() if size == 0]
    small = [name for name, size in sizes.items() if 0 < size < usual / 2]
    if empty:
        found.append(Finding("warn", "scans", f"{some(empty)}: no points; every residual image needs its scan"))
    if small:
        found.append(Finding("warn", "scans", f"{some(small)}: less than half the usual {usual:,.0f} points"))
    if not any(finding.level == "bad" for finding in found):
        found.append(Finding("ok", "scans", f"{len(keys)} scans of about {usual:,.0f} points"))
    return found


def scan_number(key: str) -> int | None:
    """The number in the name of a scan, None where there is none or several."""
    numbers = re.findall(r"\d+", key)
    return int(numbers[0]) if len(numbers) == 1 else None


def check_points(samples: Samples) -> list[Finding]:
    """NaN, origin, unit of length and range of the remission."""
    found = []
    if samples.infinite:
        text = f"{percent(samples.infinite)} hold NaN or infinity; they are left out and never moving"
        found.append(Finding("warn", "points", text))
    if samples.origin:
        text = f"{percent(samples.origin)} lie at the origin (no return); they are left out and never moving"
        found.append(Finding("warn" if samples.origin > 0.5 else "ok", "points", text))
    if len(samples.ranges) == 0:
        return [*found, Finding("bad", "points", "no scan holds a usable point")]
    near, middle, far = np.percentile(samples.ranges, [5, 50, 99])
    text = f"half of the points lie within {middle:.3g} m, 5 % within {near:.3g} m, 99 % within {far:.3g} m"
    if middle > 300:
        text += ": that looks like millimetres or map coordinates; the network needs metres in the LiDAR's frame"
        found.append(Finding("bad", "range", text))
    elif middle < 1:
        found.append(Finding("warn", "range", f"{text}: very near; are these metres?"))
    else:
        found.append(Finding("ok", "range", text))
    return [*found, _check_remission(samples.remissions)]


def _check_remission(remissions: npt.NDArray[np.float64]) -> Finding:
    low, high = remissions.min(), remissions.max()
    text = f"from {low:.3g} to {high:.3g}, mean {remissions.mean():.3g}"
    if low < -1:
        text += ": the network needs 0..1, and none is negative; are the records 4 float32 each, x y z remission?"
        return Finding("bad", "remission", text)
    if high > 1.5:
        full = 255 if high <= 255 else 65535
        return Finding("bad", "remission", f"{text}: the network needs 0..1; divide by {full}")
    if low == high:
        return Finding("warn", "remission", f"{text}: it is constant, so that the network misses one of its channels")
    if low < 0:
        return Finding("warn", "remission", f"{text}: the network needs 0..1")
    return Finding("ok", "remission", text)


def check_sensor(samples: Samples, sensor: RangeImage) -> list[Finding]:
    """Field of view and number of beams against those of the bundle."""
    if len(samples.elevations) == 0:
        return []
    down, up = np.percentile(samples.elevations, [0.5, 99.5])
    outside = float(((samples.elevations < sensor.fov_down) | (samples.elevations > sensor.fov_up)).mean())
    used = (min(up, sensor.fov_up) - max(down, sensor.fov_down)) / (sensor.fov_up - sensor.fov_down)
    fov = f"{sensor.fov_down:g} to {sensor.fov_up:g} degrees"
    text = f"points from {down:.1f} to {up:.1f} degrees, the bundle's sensor from {fov}"
    found = []
    if outside > 0.05:
        text += f": {percent(outside)} lie outside, crowded into the edge rows; {OTHER}"
        found.append(Finding("bad" if outside > 0.2 else "warn", "field of view", text))
    elif used < 0.6:
        text += f": only {percent(max(0.0, used))} of its rows are used; {OTHER}"
        found.append(Finding("bad" if used < 0.3 else "warn", "field of view", text))
    else:
        found.append(Finding("ok", "field of view", text))
    rows = f"about {samples.beams} beams, the bundle's range image has {sensor.height} rows"
    ratio = samples.beams / sensor.height
    if 0.75 <= ratio <= 1.5:
        found.append(Finding("ok", "rows", rows))
    else:
        rows += f": {'rows stay empty' if ratio < 1 else 'points hide each other'}; {OTHER}"
        found.append(Finding("bad" if ratio < 0.4 else "warn", "rows", rows))
    return found


def count_beams(scan: ScanData) -> int:
    """Beams of the sensor, by the distinct elevations within narrow sectors, rounded to a usual number."""
    points = scan[np.isfinite(scan).all(1)].astype(np.float64)
    points = points[np.linalg.norm(points[:, :3], axis=1) > 1]
    if len(points) == 0:
        return 0
    elevations = _polar(points)[1]
    sectors = ((np.arctan2(points[:, 1], points[:, 0]) / np.pi + 1) / 2 * SECTORS).astype(np.int64)
    order = np.lexsort((elevations, sectors))
    elevations, sectors = elevations[order], sectors[order]
    first = np.concatenate([[True], (np.diff(sectors) > 0) | (np.diff(elevations) > BEAM_GAP)])
    counts = np.bincount(sectors[first])
    beams = round(float(np.percentile(counts[counts > 0], 90)))
    usual = min(BEAMS, key=lambda usual: abs(usual - beams))
    return usual if abs(usual - beams) <= 0.1 * usual else beams


def _polar(points: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Range in m and elevation in degrees of points that are not at the origin."""
    ranges = np.linalg.norm(points[:, :3], axis=1)
    return ranges, np.degrees(np.arcsin(points[:, 2] / ranges))
