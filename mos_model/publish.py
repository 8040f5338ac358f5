"""From the checkpoint of a run to the one that ships: `python -m mos_model.publish RUN/last.pt OUT/checkpoint.pt`.

Keeps the tensors in half precision and chooses, on simulated streets that neither training nor validation saw, the
probabilities from which a pixel, and a point of the point head, count as moving: those of the highest IoU at which
streets without a mover stay quiet. Traffic is light, as on most streets; training streets have more movers than life,
and a threshold chosen on them would raise false alarms.
"""

import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer
from numpy.typing import NDArray

from mos_model.data.dataset import Sample, SampleConfig, SimulatedStreets
from mos_model.networks.checkpoint import Checkpoint, load, save
from runtime.bundle.manifest import Tuned
from runtime.classes import MOVING, STATIC
from runtime.commands.handler import run_alone
from runtime.commands.output import show_line
from runtime.errors import CheckpointError
from runtime.settings import CHOICES
from runtime.typed_json import build

CALIBRATION_STREETS = 15_000_000  # seeds from here on choose thresholds; validation has those below
BINS = 200
LIGHT_TRAFFIC = 0.35  # of the usual density
QUIET = 0.001  # largest share of false alarms on streets without a mover


class Histogram:
    """Probabilities of moving, counted for the static and the moving class, and for scans without a mover."""

    def __init__(self) -> None:
        self.counts = np.zeros((2, BINS), np.int64)
        self.quiet = np.zeros(BINS, np.int64)

    def add(self, probability: NDArray[np.float32], labels: NDArray[np.uint8]) -> None:
        """Count probabilities and labels of a scan, of the same shape."""
        bins = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
        static, moving = (np.bincount(bins[labels == label], minlength=BINS) for label in (STATIC, MOVING))
        if moving.any():
            self.counts += static, moving
        else:
            self.quiet += static

    def best_threshold(self, most: float = 1.0) -> tuple[float, float]:
        """The threshold of highest IoU of the moving class, and that IoU.

        most: largest share of the `quiet` static ones at or above it.
        """
        false = self.counts[0][::-1].cumsum()[::-1]  # static ones at or above the lower edge of each bin
        hit = self.counts[1][::-1].cumsum()[::-1]
        alarms = self.quiet[::-1].cumsum()[::-1] / max(1, self.quiet.sum())
        iou = hit / np.maximum(1, self.counts[1].sum() + false)
        best = int(np.where(alarms <= most, iou, -1.0).argmax())
        return best / BINS, float(iou[best])


@torch.no_grad()
def probabilities(
    found: Checkpoint, sample: Sample, candidate: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Probability of moving of the pixels (H, W), and of the points (N,) as the runtime refines them."""
    output = found.image_net(torch.from_numpy(sample.image[None]))
    image = output.logits[0].softmax(0)[MOVING]  # (H, W)
    points = image.flatten()[torch.from_numpy(sample.pixel).long()]  # (N,)
    if found.point_head is not None:
        grid = found.point_head.grid(torch.from_numpy(sample.xyz))
        features = output.features_at(0, torch.from_numpy(sample.pixel).long())  # (N, c)
        refined = found.point_head(grid, features).softmax(1)[:, MOVING]
        points = torch.where(points > candidate, refined, 0.0)
    return image.numpy(), points.numpy()


def calibrate(
    found: Checkpoint, streets: int, candidate: float = Tuned.candidate, frames: int = 2
) -> tuple[Histogram, Histogram]:
    """Histograms of pixels and of points over `streets` calibration streets with light traffic, and five times as many
    without a mover; points whose pixel is no `candidate` count as not moving."""
    samples = SampleConfig.of(found.config, points=True)
    pixels, points = Histogram(), Histogram()
    light = SimulatedStreets(samples, frames=frames, every=4, first_street=CALIBRATION_STREETS, movers=LIGHT_TRAFFIC)
    quiet = replace(light, frames=1, first_street=CALIBRATION_STREETS + 10_000, movers=0.0)
    for source, count in ((light, streets), (quiet, 5 * streets)):  # false alarms come in clumps: in few streets, many
        for number in range(count):
            for sample in source.group(number):
                image, refined = probabilities(found, sample, candidate)
                pixels.add(image, sample.labels)
                points.add(refined, sample.classes)
    return pixels, points


def data_of(training: Mapping[str, Any]) -> str:
    """What a run was trained on, in words."""
    data = training.get("data", {})
    if isinstance(data, str):  # of a checkpoint that was published before
        return data
    root = data.get("root")
    return f"recorded scans in {Path(root).name}" if root else "simulated streets of mos_model.simulator"


def publish(
    checkpoint: Annotated[Path, typer.Argument(help="Checkpoint of a run")],
    out: Annotated[Path, typer.Argument(help="Checkpoint that ships")],
    streets: Annotated[int, typer.Option(min=1, help="Simulated streets for the thresholds; 5 x without movers")] = 40,
    name: Annotated[str | None, typer.Option(help="Of the bundle", show_default="the network's")] = None,
    postprocess: Annotated[str | None, typer.Option(help="none, knn or head: the bundle's default")] = None,
    data: Annotated[
        str | None, typer.Option(help="What the weights were trained on", show_default="what the run says")
    ] = None,
    licence: Annotated[str, typer.Option(help="Of the weights, for the manifest")] = "unknown",
) -> None:
    """Write the checkpoint that ships."""
    if postprocess not in (None, *CHOICES["postprocess"]):
        raise typer.BadParameter(f"{postprocess!r} is none of {', '.join(CHOICES['postprocess'])}")
    found = load(checkpoint)
    tuned = build(Tuned, found.training.get("tuned", {}), f"{checkpoint}: tuned", CheckpointError)
    pixels, points = calibrate(found, streets, tuned.candidate)
    threshold, iou = pixels.best_threshold(QUIET)
    show_line(f"pixels: threshold {threshold:.3f}, moving IoU {100 * iou:.1f} on {streets} calibration streets")
    head_threshold = None
    if found.point_head is not None:
        head_threshold, iou = points.best_threshold(QUIET)
        show_line(f"point head: threshold {head_threshold:.3f}, moving IoU {100 * iou:.1f}")
    training = {
        "threshold": threshold,
        "head_threshold": head_threshold,
        "tuned": asdict(tuned),
        "postprocess": postprocess or ("head" if found.point_head is not None else "knn"),
        "trained": True,
        "data": data or data_of(found.training),
        "licence": licence,
        "step": found.training.get("step"),
    }
    config = found.config if name is None else replace(found.config, name=name)
    out.parent.mkdir(parents=True, exist_ok=True)
    save(out, config, found.image_net, found.point_head, training, half=True)
    show_line(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    sys.exit(run_alone(publish, "publish"))
