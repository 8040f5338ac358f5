"""A whole picture: title, legend, and for each system the strip and the view from above, side by side."""

import math

from PIL import Image, ImageDraw

from runtime.pictures.bird import draw_bird
from runtime.pictures.lettering import write, write_legend
from runtime.pictures.snapshot import Snapshot
from runtime.pictures.strip import draw_strip
from runtime.pictures.verdict import BACKGROUND, CAR_PAINT, COLOURS, FAINT, INK, legend, verdict

WIDTH = 1280  # pixels of a picture of one system
NARROW = 800  # of each system's part of a picture of several
HEAD, CAPTION, STRIP, BIRD, GAP = 44, 34, 130, 640, 12  # pixels, heights, and space between parts
SIDE = 16  # pixels left of the first letter
REACH = 50.0  # m to the left and right edge of a picture of one system; several have the same scale


def draw_sheet(snapshot: Snapshot) -> Image.Image:
    """RGB picture of a scan. Its size depends only on the number of systems."""
    systems: list[str | None] = [*snapshot.moving] or [None]  # None: the truth alone
    width = WIDTH if len(systems) == 1 else NARROW
    total = len(systems) * width + (len(systems) - 1) * GAP
    sheet = Image.new("RGB", (total, HEAD + CAPTION + STRIP + GAP + BIRD), BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    title = f"sequence {snapshot.sequence}, scan {snapshot.scan}"
    write(draw, (SIDE, HEAD / 2), title, 20, INK)
    meanings = legend(bool(snapshot.moving), snapshot.classes is not None)
    write_legend(draw, total - SIDE, HEAD / 2, meanings)
    for place, system in enumerate(systems):
        panel = _panel(snapshot, system, width)
        sheet.paste(panel, (place * (width + GAP), HEAD))
    return sheet


def _panel(snapshot: Snapshot, system: str | None, width: int) -> Image.Image:
    """What one system says: caption, strip, view from above."""
    panel = Image.new("RGB", (width, CAPTION + STRIP + GAP + BIRD), BACKGROUND)
    draw = ImageDraw.Draw(panel)
    named = write(draw, (SIDE, CAPTION / 2), system or "labels", 18, INK)
    write(draw, (SIDE + named + 14, CAPTION / 2), _score(snapshot, system), 16, FAINT)
    kinds = verdict(None if system is None else snapshot.moving[system], snapshot.classes)
    panel.paste(draw_strip(snapshot.points, kinds, (width, STRIP)), (0, CAPTION))
    reach = REACH * width / WIDTH
    panel.paste(draw_bird(snapshot.points, kinds, (width, BIRD), reach), (0, CAPTION + STRIP + GAP))
    return panel


def _score(snapshot: Snapshot, system: str | None) -> str:
    score = None if system is None else snapshot.iou(system)
    if score is None:
        return ""
    return "nothing moves" if math.isnan(score) else f"IoU {100 * score:.0f} % in this scan"


def palette() -> Image.Image:
    """The colours of all pictures, for files with 256 of them: every colour in steps down to the background."""
    colours = [INK, FAINT, CAR_PAINT, *COLOURS.values()]
    steps = 256 // len(colours)
    entries = [
        tuple(round(b + (c - b) * step / (steps - 1)) for b, c in zip(BACKGROUND, colour, strict=True))
        for colour in colours
        for step in range(steps)
    ]
    image = Image.new("P", (1, 1))
    image.putpalette([value for entry in entries for value in entry])
    return image
