"""The scan as the sensor sees it: all around from back left over forward to back right, as in its range image."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from runtime.pictures.lettering import write
from runtime.pictures.raster import SAMPLES, packed, stamp, to_canvas, to_image
from runtime.pictures.verdict import BACKGROUND, COLOURS, INK, STILL, Kinds
from runtime.recordings.scans import ScanData

COLUMNS, ROWS = 2048, 64  # of an HDL-64E: what one point covers
NEAR, FAR = 3.0, 60.0  # m: static points are brightest and darkest there
OUTLIERS = 0.1  # percent of the points that may lie above the strip, and below it


def angles_of(points: ScanData) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Azimuth (to the left), elevation (up), both in degrees, and range in m of points (N, >=3)."""
    x, y, z = points[:, :3].T
    flat = np.hypot(x, y)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arctan2(z, flat)), np.hypot(flat, z)


def draw_strip(points: ScanData, kinds: Kinds, size: tuple[int, int]) -> Image.Image:
    """Points (N, 4) m in the colours of their kinds (N,), the near before the far. RGB of `size` (width, height).

    The heights are those of the sensor's own field of view, whatever sensor it is.
    """
    width, height = size[0] * SAMPLES, size[1] * SAMPLES
    canvas = to_canvas(Image.new("RGB", (width, height), BACKGROUND))
    azimuth, elevation, distance = angles_of(points)
    seen = np.flatnonzero(np.isfinite(distance) & (distance > 0))
    if len(seen):
        order = seen[np.argsort(-distance[seen])]
        bottom, top = np.percentile(elevation[seen], (OUTLIERS, 100 - OUTLIERS))
        margin = (top - bottom) / ROWS + 0.01  # degrees, so that the outermost rows are whole
        row = (top + margin - elevation[order]) / (top - bottom + 2 * margin) * height
        column = (0.5 - azimuth[order] / 360) * width
        light = np.interp(np.log(distance[order]), np.log((NEAR, FAR)), (1.0, 0.25))
        light = np.where(kinds[order] > STILL, 1.0, light)
        colours = np.array([COLOURS[kind] for kind in sorted(COLOURS)])[kinds[order]]
        stamp(canvas, column, row, packed(light[:, None] * colours), -(-width // COLUMNS) + 1, -(-height // ROWS) + 1)
    picture = to_image(canvas).reduce(SAMPLES)
    draw = ImageDraw.Draw(picture)
    for quarter, direction in enumerate(("left", "front", "right"), 1):
        write(draw, (size[0] * quarter / 4, size[1] - 10), direction, 14, INK, "middle", outlined=True)
    return picture
