"""Time of an image network in PyTorch, ONNX Runtime and OpenVINO: `python -m bench.image_net`."""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import typer

from bench.report import interleaved, save, show, summary
from export.graph.image_graph import Outputs, image_bytes
from export.int8.prepare import prepare
from export.int8.scenes import CALIBRATION_STREETS, simulated
from mos_model.data.dataset import SampleConfig
from mos_model.networks.registry import named_config
from runtime.commands.handler import run_alone
from runtime.image.image_net import ImageNet


def compare(
    config: str, channels: int, threads: int, rounds: int, compiled: bool = False, int8: bool = False
) -> tuple[dict[str, dict[str, Any]], dict[str, float]]:
    """Times of one image with random weights by engine, in turn, and how far each engine is from PyTorch's result.

    `compiled`: PyTorch's compiler too. `int8`: 8-bit integers too, calibrated on the same simulated scans. OpenVINO has
    a row where it is installed, and one for integers where its quantiser, NNCF, is too.
    """
    torch.manual_seed(0)
    torch.set_num_threads(threads)
    model = named_config(config, channels)
    network = model.build_image_network().eval()
    shape = model.view.shape
    scenes = simulated(SampleConfig.of(model), CALIBRATION_STREETS, 2) if int8 else []
    images = [scene.image for scene in scenes]
    image = images[0][0] if int8 else np.random.default_rng(0).normal(0, 0.5, shape).astype(np.float32)
    tensor = torch.from_numpy(image[None])
    model_bytes = image_bytes(network, (1, *shape))
    whole_bytes = prepare(Outputs(network), (1, *shape), images).model() if int8 else b""
    with tempfile.TemporaryDirectory() as folder, torch.inference_mode():
        path = Path(folder) / "image_net.onnx"
        path.write_bytes(model_bytes)
        net = ImageNet(path, threads=threads)
        want = network(tensor).logits.softmax(1)[0].numpy()
        tasks: dict[str, Callable[[], Any]] = {"PyTorch eager": lambda: network(tensor)}
        differences = {}
        if compiled:
            fast = torch.compile(network)
            tasks["PyTorch compiled"] = lambda: fast(tensor)
            differences["PyTorch compiled"] = float(np.abs(fast(tensor).logits.softmax(1)[0].numpy() - want).max())
        tasks["ONNX Runtime"] = lambda: net.run(image)
        differences["ONNX Runtime"] = float(np.abs(net.run(image)[0] - want).max())
        if int8:
            integers = Path(folder) / "image_net_int8.onnx"
            integers.write_bytes(whole_bytes)
            whole = ImageNet(integers, threads=threads)
            tasks["ONNX Runtime INT8"] = lambda: whole.run(image)
            differences["ONNX Runtime INT8"] = float(np.abs(whole.run(image)[0] - want).max())
        for name, peer in openvino_peers(path, images, threads).items():
            tasks[name] = lambda peer=peer: peer(image[None])
            differences[name] = float(np.abs(peer(image[None])[0][0] - want).max())
        return {name: summary(seconds) for name, seconds in interleaved(tasks, rounds).items()}, differences


def openvino_peers(path: Path, images: list[np.ndarray], threads: int) -> dict[str, Callable[[Any], Any]]:
    """OpenVINO's networks in float, and in INT8 if there are images to calibrate on; none where it is not installed."""
    try:
        import openvino
    except ImportError:
        typer.echo("OpenVINO is not installed (pip install openvino): its row is left out", err=True)
        return {}
    core, settings = openvino.Core(), {"INFERENCE_NUM_THREADS": threads, "INFERENCE_PRECISION_HINT": "f32"}
    model = core.read_model(str(path))
    found = {"OpenVINO": core.compile_model(model, "CPU", settings)}
    if images:
        try:
            import nncf
        except ImportError:
            typer.echo("NNCF is not installed (pip install nncf): OpenVINO's INT8 is left out", err=True)
        else:
            whole = nncf.quantize(model, nncf.Dataset(images), subset_size=len(images))
            found["OpenVINO INT8"] = core.compile_model(whole, "CPU", settings)
    return found


def bench(
    config: Annotated[str, typer.Option(help="Network: lmnet, b, c, d, e, v1, rt, limoseg")] = "v1",
    channels: int = 32,
    threads: int = 2,
    rounds: int = 7,
    compiled: Annotated[bool, typer.Option("--compiled", help="PyTorch's compiler too")] = False,
    int8: Annotated[bool, typer.Option("--int8", help="8-bit integers too, ours and OpenVINO's")] = False,
    out: Annotated[Path | None, typer.Option(help="JSON file")] = None,
) -> None:
    """Median time of one image with random weights; outputs are compared first. OpenVINO only where it is installed."""
    rows, differences = compare(config, channels, threads, rounds, compiled, int8)
    for name, row in rows.items():
        row["of PyTorch"] = round(row["median"] / rows["PyTorch eager"]["median"], 3)
        row["largest difference"] = f"{differences.get(name, 0.0):.0e}"
    show(f"{config}, {channels} channels, {threads} threads, ms", rows)
    save(out, threads, {"config": config, "channels": channels, "ms": rows})


if __name__ == "__main__":
    sys.exit(run_alone(bench, "image_net"))
