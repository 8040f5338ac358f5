"""Whether a bundle is what it says: every file looked through, every network run once."""

from collections.abc import Iterator

import numpy as np

from runtime.bundle.known_networks import check_network, described
from runtime.bundle.loading import Bundle
from runtime.bundle.manifest import CYLINDER_NET, IMAGE_NET, IMAGE_NET_INT8, POINT_HEAD, POINT_HEAD_ONNX
from runtime.compute.workers import Workers
from runtime.head.networks import open_network
from runtime.head.numba_engine import PointHeadEngine
from runtime.head.onnx_engine import OnnxHead


def verify(bundle: Bundle) -> Iterator[tuple[str, str]]:
    """What was checked of a loaded bundle, file by file, in words. Raises BundleError or InferenceError."""
    manifest, workers = bundle.manifest, Workers(1)
    for name, entry in manifest.files.items():
        yield name, f"{entry.bytes:,} bytes, SHA-256 as the manifest says"
        if name.endswith(".onnx"):
            for text in described(check_network(bundle.path / name)):
                yield "", text
        if name in (IMAGE_NET, IMAGE_NET_INT8, CYLINDER_NET):
            view = manifest.view(manifest.sensor)
            net = open_network(bundle, "int8" if name == IMAGE_NET_INT8 else "float32", view, workers)
            seen = net.run(np.zeros(view.shape, np.float32))
            shapes = f"probabilities {seen.probabilities.shape} and features {seen.features.shape}"
            yield "", f"run with an empty image: {shapes}, finite"
        elif manifest.point_head is not None and name == POINT_HEAD:
            PointHeadEngine(bundle.point_head(), manifest.point_head, workers).warm_up()
            yield "", "its weights are all there, finite, of the shapes that the manifest says; run with a wall"
        elif manifest.point_head is not None and name == POINT_HEAD_ONNX:
            OnnxHead(bundle.path / name, manifest.point_head, workers).warm_up()
            yield "", "run with a wall: probabilities of every voxel, finite"
