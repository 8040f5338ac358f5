"""A static map from above, with and without what moved there."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from runtime.files import write_whole
from runtime.pictures.lettering import write
from runtime.pictures.raster import SAMPLES, packed, stamp, to_canvas, to_image
from runtime.pictures.verdict import BACKGROUND, COLOURS, FOUND, INK, STILL

SIDE = 720  # pixels of each half
COMMON = (0.002, 0.998)  # quantiles of the places between which the picture shows all


def draw_map(path: str | Path, still: NDArray[np.floating], moved: NDArray[np.floating]) -> None:
    """Write a .png of two halves: all that was seen, and what stands still. Raises OutputError.

    still, moved: (M, 3) m in one frame; x goes to the right, y up.
    """
    places = still if len(still) else np.zeros((1, 3), np.float32)
    low, high = np.quantile(places[:, :2], COMMON, axis=0)
    scale = SAMPLES * (SIDE - 40) / max(1.0, float((high - low).max()))
    middle = (low + high) / 2
    bottom, top = np.quantile(places[:, 2], (0.02, 0.98))
    light = np.interp(places[:, 2], (bottom, top + 1e-3), (0.35, 1.0))
    page = Image.new("RGB", (2 * SIDE, SIDE), BACKGROUND)
    for half, title in enumerate(("all that was seen", "what stands still")):
        canvas = to_canvas(Image.new("RGB", (SIDE * SAMPLES, SIDE * SAMPLES), BACKGROUND))
        layers = [(places, packed(light[:, None] * COLOURS[STILL]), 2)]
        if half == 0:
            layers.append((moved, packed(np.ones((len(moved), 1)) * COLOURS[FOUND]), 3))
        for points, colours, size in layers:
            order = np.argsort(points[:, 2])
            column = SIDE * SAMPLES / 2 + (points[order, 0] - middle[0]) * scale
            row = SIDE * SAMPLES / 2 - (points[order, 1] - middle[1]) * scale
            stamp(canvas, column, row, colours[order], size)
        page.paste(to_image(canvas).reduce(SAMPLES), (half * SIDE, 0))
        write(ImageDraw.Draw(page), (half * SIDE + 16, 22), title, 16, INK)
    data = io.BytesIO()
    page.save(data, "PNG", optimize=True)
    write_whole(path, data.getvalue())
