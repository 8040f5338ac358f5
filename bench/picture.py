"""A picture of a simulated scan and what a bundle says of it: `python -m bench.picture models/rt/street.png`."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from PIL import Image

from mos_model.simulator import simulate
from runtime import MosRunner
from runtime.inputs import InputBuilder
from runtime.labels import to_classes
from runtime.sensor import HISTORY
from runtime.workers import Workers

COLOURS = np.array(  # RGB of: empty, static, moving and found, moving but missed, static but called moving
    [(255, 255, 255), (150, 160, 170), (214, 39, 40), (255, 170, 0), (31, 119, 180)], np.uint8
)


def verdict(classes: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Row of COLOURS for every point."""
    return np.where(classes == 2, np.where(moving, 2, 3), np.where(moving & (classes == 1), 4, 1))


def bird_view(points: np.ndarray, kinds: np.ndarray, reach: float = 40.0, scale: float = 11.0) -> np.ndarray:
    """Seen from above, x to the right; movers are drawn last and larger."""
    height, width = int(reach * scale), int(2 * reach * scale)
    canvas = np.zeros((height, width), np.uint8)
    column = ((points[:, 0] + reach) * scale).astype(int)
    row = ((reach / 2 - points[:, 1]) * scale).astype(int)
    for kind in range(1, len(COLOURS)):
        size = 1 if kind == 1 else 3
        for dy in range(size):
            for dx in range(size):
                x, y = column + dx - size // 2, row + dy - size // 2
                seen = (kinds == kind) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
                canvas[y[seen], x[seen]] = kind
    return COLOURS[canvas]


def draw(
    out: Annotated[Path, typer.Argument(help="PNG file")],
    bundle: Annotated[Path | None, typer.Option(help="Bundle; else the default one")] = None,
    seed: Annotated[int, typer.Option(help="Of the street")] = 12_000_002,
) -> None:
    """Bird's-eye view over the range image: found movers red, missed ones orange, false alarms blue."""
    frames = list(simulate(seed, HISTORY + 1))
    runner = MosRunner(bundle)
    for frame in frames:
        result = runner(frame.points, frame.pose)
    points, classes = frames[-1].points, to_classes(frames[-1].labels)
    kinds = verdict(classes, result.moving)
    manifest = runner.bundle.manifest
    made = InputBuilder(manifest.sensor, manifest.residual, Workers(1)).build(points, [], [])
    strip = COLOURS[np.where(made.first >= 0, kinds[made.first], 0)].astype(np.float32)
    shade = np.clip(1.1 - made.range_image / 70, 0.35, 1)[..., None]
    strip = np.where((made.first >= 0)[..., None], strip * shade, 255).astype(np.uint8)
    view = bird_view(points, kinds)
    image = Image.fromarray(strip).resize((view.shape[1], 2 * strip.shape[0]), Image.Resampling.BILINEAR)
    Image.fromarray(np.concatenate([np.asarray(image), view])).quantize(64).save(out)


if __name__ == "__main__":
    typer.run(draw)
