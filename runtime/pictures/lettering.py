"""Words in pictures, in the font that comes with Pillow."""

import math
from functools import lru_cache

from PIL import Image, ImageDraw, ImageFont

from runtime.pictures.verdict import BACKGROUND, COLOURS, FAINT

FINE = 4  # letters are drawn so many times larger, for their true shapes and distances

Colour = tuple[int, int, int]


@lru_cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """Pillow's own font, `size` pixels high."""
    found = ImageFont.load_default(size)
    assert isinstance(found, ImageFont.FreeTypeFont)
    return found


def write(
    draw: ImageDraw.ImageDraw,
    place: tuple[float, float],
    text: str,
    size: int,
    colour: Colour,
    side: str = "left",
    outlined: bool = False,
) -> float:
    """Write one line whose `side` ("left", "middle", "right") is at `place`, around that height. Returns its width.

    outlined: in the colour of the background, to be read on points too.
    """
    large = font(size * FINE)
    width = large.getlength(text) / FINE
    left = place[0] - {"left": 0, "middle": width / 2, "right": width}[side]
    for stroke, paint in ((2 * FINE, BACKGROUND), (0, colour))[not outlined :]:
        mask = Image.new("L", ((math.ceil(width) + 2 * size) * FINE, 2 * size * FINE))
        ImageDraw.Draw(mask).text((size * FINE, size * FINE), text, 255, large, "lm", stroke_width=stroke)
        draw.bitmap((round(left) - size, round(place[1]) - size), mask.reduce(FINE), paint)
    return width


def write_legend(draw: ImageDraw.ImageDraw, right: float, middle: float, meanings: list[tuple[int, str]]) -> None:
    """Spots of colour and what they mean, in one line that ends at `right`, around the height `middle`."""
    for kind, meaning in reversed(meanings):
        right -= write(draw, (right, middle), meaning, 16, FAINT, "right") + 16
        draw.circle((right, middle), 7, COLOURS[kind])
        right -= 25
