"""From the checkpoint of a run to the one that ships: `python -m mos_model.publish RUN/best.pt OUT/checkpoint.pt`.

Keeps the tensors in half precision and chooses, on simulated streets that neither training nor validation saw, the
probability from which a pixel counts as moving. Their traffic is light, as on most streets; training streets have more
movers than life, and a threshold chosen on them would raise false alarms.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from numpy.typing import NDArray
from torch import nn

from mos_model.checkpoint import load, save
from mos_model.dataset import SampleConfig, SimulatedStreets
from mos_model.labels import MOVING, STATIC

CALIBRATION_STREETS = 15_000_000  # seeds from here on choose thresholds; validation has those below
BINS = 200
LIGHT_TRAFFIC = 0.35  # of the usual density


def moving_histogram(network: nn.Module, streets: SimulatedStreets, count: int) -> NDArray[np.int64]:
    """(2, BINS) pixels of the static and of the moving class by their probability of moving, over `count` streets."""
    found = np.zeros((2, BINS), np.int64)
    for number in range(count):
        for sample in streets.group(number):
            with torch.inference_mode():
                logits = network(torch.from_numpy(sample.image[None])).logits[0]
            p = logits.softmax(0)[MOVING].numpy()
            bins = np.minimum((p * BINS).astype(np.int64), BINS - 1)
            for row, label in enumerate((STATIC, MOVING)):
                found[row] += np.bincount(bins[sample.labels == label], minlength=BINS)
    return found


def best_threshold(histogram: NDArray[np.int64]) -> tuple[float, float]:
    """The threshold of highest IoU of the moving class, and that IoU."""
    false = histogram[0][::-1].cumsum()[::-1]  # static pixels at or above the lower edge of each bin
    hit = histogram[1][::-1].cumsum()[::-1]
    iou = hit / np.maximum(1, histogram[1].sum() + false)
    best = int(iou.argmax())
    return best / BINS, float(iou[best])


def publish(
    checkpoint: Annotated[Path, typer.Argument(help="Checkpoint of a run")],
    out: Annotated[Path, typer.Argument(help="Checkpoint that ships")],
    streets: Annotated[int, typer.Option(help="Simulated streets that choose the threshold")] = 40,
    postprocess: Annotated[str | None, typer.Option(help="none, knn or head: the bundle's default")] = None,
    data: Annotated[str, typer.Option(help="What the weights were trained on, for the manifest")] = (
        "simulated streets of mos_model.simulator"
    ),
) -> None:
    """Write the checkpoint that ships."""
    found = load(checkpoint)
    config = found.config
    samples = SampleConfig(config.sensor, config.residual)
    source_of = SimulatedStreets(samples, frames=2, every=4, first_street=CALIBRATION_STREETS, movers=LIGHT_TRAFFIC)
    threshold, iou = best_threshold(moving_histogram(found.image_net, source_of, streets))
    typer.echo(f"threshold {threshold:.3f}: moving IoU {100 * iou:.1f} of the pixels of {streets} calibration streets")
    training = {
        "threshold": threshold,
        "postprocess": postprocess or ("head" if found.point_head is not None else "knn"),
        "trained": True,
        "data": data,
        "step": found.training.get("step"),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    save(out, config, found.image_net, found.point_head, training, half=True)
    typer.echo(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    typer.run(publish)
