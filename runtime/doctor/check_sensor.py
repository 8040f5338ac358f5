"""Is the sensor the one that the network was made for? Another costs accuracy; one that looks elsewhere, all of it."""

from collections.abc import Sequence

import numpy as np

from runtime.doctor.findings import Finding, percent
from runtime.doctor.sample import Sample, Values, middle, quantile, share_below
from runtime.sensors.range_image import RangeImage

LITTLE, HARDLY = 0.6, 0.3  # share of the rows that a sensor fills at least, if it fits, and if labels mean anything
CROWDED = 0.05  # share of the points outside the rows, at most
SECTORS = 719  # of half a degree, in each of which a beam leaves points of nearly one elevation; odd, so that their
# edges do not fall on the columns of a sensor
BEAM_GAP = 0.1  # degrees between neighbouring beams, at least
OTHER = "use a bundle made for your sensor, if these are points in its own frame"
BEAMS = (16, 32, 40, 64, 80, 128)  # that sensors have


def check_sensor(samples: Sequence[Sample], image: RangeImage) -> list[Finding]:
    """Field of view and number of beams against those of the bundle; samples of whole scans."""
    seen = [sample for sample in samples if sample.tells]
    return [check_view(seen, image), _check_rows(seen, image)] if seen else []


def check_view(samples: Sequence[Sample], image: RangeImage) -> Finding:
    """Field of view against that of the bundle; each sample has usable points."""
    down, up = (middle(quantile(sample.elevations, share) for sample in samples) for share in (0.005, 0.995))
    outside = middle(_outside(sample.elevations, image) for sample in samples)
    used = (min(up, image.fov_up) - max(down, image.fov_down)) / (image.fov_up - image.fov_down)
    fov = f"{image.fov_down:g} to {image.fov_up:g} degrees"
    text = f"points from {down:.1f} to {up:.1f} degrees, the bundle's sensor from {fov}"
    if used < LITTLE:
        text += f": only {percent(max(0.0, used))} of its rows are used; {OTHER}"
        return Finding("bad" if used < HARDLY else "warn", "field of view", text)
    if outside > CROWDED:
        text += f": {percent(outside)} lie outside, crowded into the edge rows; {OTHER}"
        return Finding("warn", "field of view", text)
    return Finding("ok", "field of view", text)


def _outside(elevations: Values, image: RangeImage) -> float:
    """Share of the elevations, in order."""
    return share_below(elevations, image.fov_down) + 1 - share_below(elevations, image.fov_up)


def _check_rows(samples: Sequence[Sample], image: RangeImage) -> Finding:
    beams = count_beams(sorted(samples, key=lambda sample: sample.points)[len(samples) // 2])
    rows = f"about {beams} beams, the bundle's range image has {image.height} rows"
    ratio = beams / image.height
    if 0.75 <= ratio <= 1.5:
        return Finding("ok", "rows", rows)
    return Finding("warn", "rows", f"{rows}: {'rows stay empty' if ratio < 1 else 'points hide each other'}; {OTHER}")


def count_beams(sample: Sample) -> int:
    """Beams of the sensor, by the distinct elevations within narrow sectors, rounded to a usual number."""
    away = sample.ranges > 1
    points = sample.xyz[away].astype(np.float64)
    if len(points) == 0:
        return 0
    elevations = np.degrees(np.arcsin(np.clip(points[:, 2] / sample.ranges[away], -1, 1)))
    sectors = ((np.arctan2(points[:, 1], points[:, 0]) / np.pi + 1) / 2 * SECTORS).astype(np.int64)
    order = np.lexsort((elevations, sectors))
    elevations, sectors = elevations[order], sectors[order]
    first = np.concatenate([[True], (np.diff(sectors) > 0) | (np.diff(elevations) > BEAM_GAP)])
    counts = np.bincount(sectors[first])
    beams = round(float(np.percentile(counts[counts > 0], 90)))
    usual = min(BEAMS, key=lambda usual: abs(usual - beams))
    return usual if abs(usual - beams) <= 0.1 * usual else beams
