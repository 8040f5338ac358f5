"""Points on a canvas, whose pixels are whole numbers so that many of them are set at once."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

SAMPLES = 2  # canvas pixels to a pixel of the picture, each way: edges become smooth

Canvas = NDArray[np.uint32]  # (H, W) red, green, blue and one unused byte


def to_canvas(image: Image.Image) -> Canvas:
    """A copy of an RGB picture to draw on."""
    return np.array(image.convert("RGBX")).view(np.uint32)[..., 0]


def to_image(canvas: Canvas) -> Image.Image:
    """The RGB picture that a canvas was made into."""
    size = canvas.shape[1], canvas.shape[0]
    return Image.frombytes("RGBX", size, canvas.tobytes()).convert("RGB")


def packed(colours: NDArray[np.floating] | NDArray[np.integer]) -> NDArray[np.uint32]:
    """Pixels (n,) of RGB colours (n, 3) 0..255."""
    found = np.full((len(colours), 4), 255, np.uint8)
    found[:, :3] = colours
    return found.view(np.uint32)[:, 0]


def stamp(
    canvas: Canvas,
    column: NDArray[np.floating],
    row: NDArray[np.floating],
    pixels: NDArray[np.uint32],
    width: int,
    height: int | None = None,
) -> None:
    """Draw a rectangle of `width` x `height` canvas pixels (None: a disc of that width) around every point, in order.

    column, row: (n,) canvas pixels; points whose stamp does not lie on the canvas are left out. pixels: (n,).
    """
    rows, columns = canvas.shape
    dy, dx = np.transpose(_offsets(width, height))
    inside = (column >= -dx.min()) & (column < columns - dx.max()) & (row >= -dy.min()) & (row < rows - dy.max())
    cell = row[inside].astype(np.int32) * np.int32(columns) + column[inside].astype(np.int32)
    flat, pixels = canvas.reshape(-1), pixels[inside]
    for offset in (dy * columns + dx).astype(np.int32):
        flat[cell + offset] = pixels


def _offsets(width: int, height: int | None) -> list[tuple[int, int]]:
    """(dy, dx) of the pixels of a stamp."""
    rows = width if height is None else height
    found = [(y - rows // 2, x - width // 2) for y in range(rows) for x in range(width)]
    if height is None and width >= 5:
        middle, radius = (width - 1) / 2 - width // 2, width / 2
        found = [(y, x) for y, x in found if (y - middle) ** 2 + (x - middle) ** 2 <= radius**2]
    return found
