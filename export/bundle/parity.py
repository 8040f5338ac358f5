"""The gate of the export: PyTorch and the finished bundle, side by side on a simulated street."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from mos_model.networks.image_output import ImageOutput
from mos_model.networks.point_head import PointHead as TorchHead
from mos_model.simulator import simulate
from runtime.bundle.loading import Bundle
from runtime.bundle.manifest import POINT_HEAD, POINT_HEAD_ONNX, Manifest
from runtime.bundle.residual import HISTORY
from runtime.compute.workers import Workers
from runtime.errors import ParityError
from runtime.head.networks import open_network
from runtime.head.numba_engine import PointHeadEngine
from runtime.head.onnx_engine import OnnxHead
from runtime.head.refinement import PointHead
from runtime.head.transfer import FeatureMap
from runtime.image.entry import Entered
from runtime.image.inputs import ImageInput
from runtime.image.making import make_inputs

LIMIT = 1e-4  # largest difference of a probability
SEED = 2026  # of the simulated street


@dataclass(frozen=True)
class Parity:
    """Largest differences between PyTorch and the bundle over one scan."""

    image_net: float  # of a probability of a pixel
    features: float  # of a feature, relative to the largest one
    point_head: float | None  # of a probability of a point, each side with its own image network
    points: int  # points of the scan
    point_head_onnx: float | None = None  # the same with the point head as an ONNX graph, where the bundle has it

    def worst(self) -> float:
        """Largest difference of a probability."""
        return max(self.image_net, self.point_head or 0.0, self.point_head_onnx or 0.0)

    def to_manifest(self) -> dict[str, Any]:
        """Rounded up to one digit, so that the last bits of another machine make no other bundle."""
        figures = {
            "image_net": self.image_net,
            "features": self.features,
            "point_head": self.point_head,
            "point_head_onnx": self.point_head_onnx,
        }
        measured = {key: _rounded_up(value) for key, value in figures.items() if value is not None}
        return {**measured, "against": "PyTorch", "input": f"simulated scan of {self.points} points", "limit": LIMIT}


def check_parity(bundle: Bundle, image_net: nn.Module, point_head: TorchHead | None, threads: int = 2) -> Parity:
    """Compare a bundle with the modules that it was made from. Raises ParityError beyond LIMIT."""
    manifest = bundle.manifest
    workers = Workers(threads)
    scan, image = simulated_input(manifest, workers)
    with torch.inference_mode():
        want = image_net(torch.from_numpy(image.image[None]))
        want_probabilities, want_features = want.logits.softmax(1)[0].numpy(), want.features[0].numpy()
    net = open_network(bundle, "float32", manifest.view(manifest.sensor), workers)
    probabilities, features = net.run(image.image)
    heads = _head_differences(bundle, point_head, scan, image, features, want, workers)
    parity = Parity(
        image_net=_difference(probabilities, want_probabilities),
        features=_difference(features, want_features) / max(float(np.abs(want_features).max()), 1e-30),
        point_head=heads.get(POINT_HEAD),
        points=len(scan),
        point_head_onnx=heads.get(POINT_HEAD_ONNX),
    )
    workers.close()
    if not parity.worst() <= LIMIT:  # NaN fails too
        raise ParityError(
            f"the exported network differs from PyTorch by {parity.worst():.1e} in a probability "
            f"(image network {parity.image_net:.1e}, point head {parity.point_head}, as ONNX graph "
            f"{parity.point_head_onnx}); the limit is {LIMIT:g}. "
            "Nothing was written"
        )
    return parity


def simulated_input(manifest: Manifest, workers: Workers) -> tuple[Entered, ImageInput]:
    """The last scan of a drive of a bundle's sensor, simulated with a full history, and the network's input for it."""
    sensor = manifest.sensor
    drive = [(frame.points, frame.pose) for frame in simulate(SEED, HISTORY + 1, sensor.name, movers=1.6)]
    return make_inputs(manifest.view(sensor), workers, sensor.reach).image_of(drive)


def _head_differences(
    bundle: Bundle,
    head: TorchHead | None,
    scan: Entered,
    image: ImageInput,
    features: np.ndarray,
    want: ImageOutput,
    workers: Workers,
) -> dict[str, float]:
    """Of the probabilities of points, by file of the bundle."""
    config = bundle.manifest.point_head
    if head is None or config is None:
        return {}
    valid = image.pixel >= 0
    xyz = np.ascontiguousarray(scan.points[:, :3])
    with torch.inference_mode():
        of_points = want.features_at(0, torch.from_numpy(image.pixel[valid]).long())
        of_head = head(head.grid(torch.from_numpy(xyz[valid])), of_points).softmax(1).numpy()
    engines: dict[str, PointHead] = {POINT_HEAD: PointHeadEngine(bundle.point_head(), config, workers)}
    if POINT_HEAD_ONNX in bundle.manifest.files:
        engines[POINT_HEAD_ONNX] = OnnxHead(bundle.path / POINT_HEAD_ONNX, config, workers)
    given = xyz, valid, FeatureMap(features, image.pixel, image.image.shape[2])
    return {name: _difference(engine.refine(*given)[valid], of_head) for name, engine in engines.items()}


def _difference(got: np.ndarray, want: np.ndarray) -> float:
    """Largest absolute difference; infinite where either is not finite."""
    difference = float(np.abs(got - want).max()) if got.size else 0.0
    return difference if np.isfinite(difference) else float("inf")


def _rounded_up(value: float) -> float:
    """To one significant digit."""
    if value == 0:
        return 0.0
    step = 10.0 ** np.floor(np.log10(value))
    return float(f"{np.ceil(value / step) * step:.0e}")
