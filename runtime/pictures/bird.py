"""The view from above: forward is to the right, left is up, the car in the middle."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from runtime.pictures.lettering import write
from runtime.pictures.raster import SAMPLES, packed, stamp, to_canvas, to_image
from runtime.pictures.verdict import BACKGROUND, CAR_PAINT, COLOURS, INK, STILL, Kinds
from runtime.recordings.scans import ScanData

RING_STEP = 10  # m
RING = (52, 62, 78)
CAR = (4.2, 1.8)  # m, length and width of the car that carries the LiDAR, drawn around it
PLAIN, MARKED = 3, 6  # canvas pixels, size of a point that is static and of one that is not
FLOOR, ROOF = -2.0, 2.5  # m above the LiDAR: static points are darkest and brightest there


def pixels_of(points: ScanData, size: tuple[int, int], reach: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Columns and rows of points (N, >=2) m in a picture of `size` (width, height) that shows x in +-reach m."""
    scale = size[0] / (2 * reach)
    return size[0] / 2 + points[:, 0] * scale, size[1] / 2 - points[:, 1] * scale


def draw_bird(points: ScanData, kinds: Kinds, size: tuple[int, int], reach: float) -> Image.Image:
    """Points (N, 4) m in the colours of their kinds (N,); what moves is larger and lies on top. RGB of `size`."""
    shown = np.isfinite(points[:, :3]).all(axis=1)
    points, kinds = points[shown], kinds[shown]
    large = (size[0] * SAMPLES, size[1] * SAMPLES)
    ground = Image.new("RGB", large, BACKGROUND)
    _rings(ImageDraw.Draw(ground), large, reach)
    canvas = to_canvas(ground)
    column, row = pixels_of(points, large, reach)
    light = np.interp(points[:, 2], (FLOOR, ROOF), (0.6, 1.0))
    order = np.argsort(points[:, 2])  # what is higher hides what is below
    for kind, colour in COLOURS.items():
        chosen = order[kinds[order] == kind]
        plain = kind <= STILL
        shade = light[chosen, None] if plain else np.ones((len(chosen), 1))
        stamp(canvas, column[chosen], row[chosen], packed(shade * colour), PLAIN if plain else MARKED)
    picture = to_image(canvas)
    _car(ImageDraw.Draw(picture), large, reach)
    picture = picture.reduce(SAMPLES)
    _distances(ImageDraw.Draw(picture), size, reach)
    return picture


def _rings(draw: ImageDraw.ImageDraw, size: tuple[int, int], reach: float) -> None:
    """A circle every RING_STEP m, and the directions forward, back, left and right."""
    (u, v), scale = (size[0] / 2, size[1] / 2), size[0] / (2 * reach)
    draw.line((0, v, size[0], v), RING, SAMPLES)
    draw.line((u, 0, u, size[1]), RING, SAMPLES)
    for distance in range(RING_STEP, int(1.5 * reach), RING_STEP):
        draw.circle((u, v), distance * scale, outline=RING, width=SAMPLES)


def _distances(draw: ImageDraw.ImageDraw, size: tuple[int, int], reach: float) -> None:
    """The radius of every ring, below the axis that points forward."""
    scale = size[0] / (2 * reach)
    for distance in range(RING_STEP, int(reach) + 1, RING_STEP):
        edge = size[0] / 2 + distance * scale
        write(draw, (edge - 5, size[1] / 2 + 11), f"{distance} m", 14, INK, "right", outlined=True)


def _car(draw: ImageDraw.ImageDraw, size: tuple[int, int], reach: float) -> None:
    """The car that carries the LiDAR, its windscreen towards the front."""
    (u, v), scale = (size[0] / 2, size[1] / 2), size[0] / (2 * reach)
    length, width = CAR[0] * scale, CAR[1] * scale
    corners = (u - length / 2, v - width / 2, u + length / 2, v + width / 2)
    draw.rounded_rectangle(corners, width / 3, CAR_PAINT, BACKGROUND, SAMPLES)
    screen = [(0.12, -0.34), (0.26, -0.38), (0.26, 0.38), (0.12, 0.34)]
    draw.polygon([(u + x * length, v + y * width) for x, y in screen], BACKGROUND)
