"""What kernels of 7 bits cost against 8, whose sums saturate without VNNI: `python -m bench.kernel_bits CHECKPOINT`."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from bench.report import save, show
from export.graph.image_graph import Outputs, image_bytes
from export.graph.serialise import onnx_bytes
from export.int8.judge import Judge
from export.int8.prepare import prepare
from export.int8.scenes import CALIBRATION_STREETS, JUDGING_STREETS, simulated
from mos_model.data.dataset import SampleConfig
from mos_model.networks.checkpoint import load
from runtime.commands.handler import run_alone

LARGEST = {"7 bits": 64, "8 bits": 127}  # of a kernel's integers


def bench(
    checkpoint: Annotated[Path, typer.Argument(help="A trained checkpoint of lidar-mos")],
    streets: Annotated[int, typer.Option(help="Simulated streets for the ranges, two scans each")] = 8,
    judging: Annotated[int, typer.Option(help="Simulated streets for the loss, two scans each")] = 16,
    threads: int = 2,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """IoU of the moving class, pixels, in %; the integers are computed in float, where no sum saturates."""
    found = load(checkpoint)
    config = found.config
    samples = SampleConfig.of(config)
    images = [scene.image for scene in simulated(samples, CALIBRATION_STREETS, streets)]
    prepared = prepare(Outputs(found.image_net).eval(), images[0].shape, images)
    scenes = simulated(samples, JUDGING_STREETS, judging)
    float_model = image_bytes(found.image_net, images[0].shape)
    judge = Judge(float_model, scenes, found.training.get("threshold"), threads)
    rows = {}
    for name, largest in LARGEST.items():
        loss = judge.loss(onnx_bytes(prepared.pairs(largest=largest)))
        rows[name] = {"float": loss.before, "int8": loss.after, "difference of a probability": loss.difference}
    show(f"{config.name}: IoU of the moving class, {len(scenes)} simulated scans, %", rows)
    save(out, threads, {"checkpoint": config.name, "scans": len(scenes), "percent": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "kernel_bits"))
