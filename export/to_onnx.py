"""`mos export`, `python export/to_onnx.py`: checkpoint -> bundle. What is heavy is imported when it runs."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from runtime.commands.handler import need_extra, run_alone
from runtime.commands.output import show_line
from runtime.errors import CheckpointError

if TYPE_CHECKING:
    from export.convert import Export

ROOT = Path(__file__).resolve().parents[1]


def of_an_image(pixels: int | None) -> int | None:
    """Rows or columns that the networks can halve four times."""
    if pixels is not None and (pixels < 16 or pixels % 16):
        raise typer.BadParameter(f"{pixels} is no positive multiple of 16")
    return pixels


def export(
    checkpoint: Annotated[
        Path | None, typer.Option(help="Checkpoint: ours, or a published one.", show_default="the default bundle's")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the bundle.", show_default="models/ and the checkpoint's name")
    ] = None,
    network: Annotated[
        str | None,
        typer.Option(help="Published network, where its file leaves it open: b, c, d, e.", show_default="by its keys"),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(help="Store kernels as float32 or float16.", show_default="float16 for ours, else float32"),
    ] = None,
    height: Annotated[
        int | None,
        typer.Option(help="Rows of the range image.", show_default="the checkpoint's", callback=of_an_image),
    ] = None,
    width: Annotated[
        int | None,
        typer.Option(help="Columns of the range image.", show_default="the checkpoint's", callback=of_an_image),
    ] = None,
    untrained: Annotated[
        bool, typer.Option("--untrained", help="Say in the manifest that the weights are random.")
    ] = False,
    point_head_onnx: Annotated[
        bool, typer.Option("--point-head-onnx", help="Write the point head as an ONNX graph too, for GPUs.")
    ] = False,
    precision: Annotated[
        str | None,
        typer.Option(
            help="float32, or int8: the image network in 8-bit integers too, calibrated and judged.",
            show_default="that of the bundle that is there, else float32",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Own sequence for the ranges of int8, as mos run reads it.", show_default="simulated streets"
        ),
    ] = None,
    threads: Annotated[int, typer.Option(min=1, help="Threads of the comparison.")] = 2,
) -> None:
    """Turn a checkpoint, ours or a published one, into a bundle, and compare the two (extra 'export')."""
    if calibration is not None and precision not in (None, "int8"):
        raise typer.BadParameter(f"--calibration is for --precision int8, not for {precision}")
    need_extra("export", "torch", "onnx")
    from export.convert import export_checkpoint
    from export.int8.quantise import Settings

    if checkpoint is None:
        checkpoint, folder = default_checkpoint()
    else:
        folder = Path("models") / (checkpoint.parent.name if checkpoint.stem == "checkpoint" else checkpoint.stem)
    done = export_checkpoint(
        checkpoint,
        out or folder,
        network,
        weights,
        height,
        width,
        False if untrained else None,
        threads,
        point_head_onnx,
        precision,
        None if calibration is None else Settings(calibration=calibration, threads=threads),
    )
    show(done, checkpoint)


def default_checkpoint() -> tuple[Path, Path]:
    """Checkpoint of the default bundle of this checkout, or else the tiny one; and the folder for its bundle."""
    from runtime.bundle.loading import DEFAULT_BUNDLE

    for checkpoint, out in (
        (ROOT / "models" / DEFAULT_BUNDLE / "checkpoint.pt", ROOT / "models" / DEFAULT_BUNDLE),
        (ROOT / "tests" / "data" / "tiny" / "checkpoint.pt", ROOT / "models" / "tiny"),
    ):
        if checkpoint.is_file():
            return checkpoint, out
    raise CheckpointError(
        "there is no checkpoint of a default bundle here: give one by --checkpoint X --out models/NAME"
    )


def show(done: "Export", checkpoint: Path) -> None:
    """Print what was read, dropped, measured and written."""
    from runtime.bundle.manifest import IMAGE_NET_INT8

    source, bundle, parity = done.source, done.bundle, done.parity
    config, files = source.config, bundle.manifest.files
    size = f"{config.range_image.height} x {config.range_image.width}"
    show_line(f"read     {checkpoint}: {source.origin}, network {config.name}, {config.channels} channels, {size}")
    if source.dropped:
        blocks = sorted({key.split(".")[0] for key in source.dropped})
        show_line(f"dropped  {len(source.dropped)} tensors that the network does not use: {', '.join(blocks)}")
    head = "" if parity.point_head is None else f", point head {parity.point_head:.1e}"
    head += "" if parity.point_head_onnx is None else f", as ONNX graph {parity.point_head_onnx:.1e}"
    show_line(f"parity   image network {parity.image_net:.1e}{head} (largest difference of a probability)")
    if IMAGE_NET_INT8 in files:
        show_line(f"int8     {_words(bundle.manifest.accuracy['int8'])}")
    for name, entry in files.items():
        show_line(f"wrote    {bundle.path / name}: {entry.bytes / 1e6:.2f} MB, kernels in {entry.precision}")
    if not source.trained:
        show_line("note     the weights are not trained: for tests only")


def _words(record: Mapping[str, Any]) -> str:
    """What an INT8 export measured."""
    iou = f"IoU {record['iou_float']:.2f} % to {record['iou_int8']:.2f} %, " if "iou_int8" in record else ""
    floats = ", ".join(record["float_layers"]) or "none"
    difference = f"mean difference of a probability {record['probability_difference']:.1e}"
    return f"{iou}{difference}, layers left in float: {floats}"


if __name__ == "__main__":
    sys.exit(run_alone(export, "mos export"))
