"""Which network a bundle holds: the one place that tells those of images from those of points."""

import warnings
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.loading import Bundle
from runtime.bundle.view import View
from runtime.compute.sessions import CPU, ON_CPU, Execution, provider_name
from runtime.compute.workers import Workers
from runtime.errors import MosWarning, ProviderError
from runtime.head.cylinder.cylinder_net import CylinderNet
from runtime.image.image_net import ImageNet, Seen


class Network(Protocol):
    """What `runtime.image.making.make_inputs` makes inputs for."""

    @property
    def providers(self) -> Sequence[str]:
        """Execution providers that were started."""

    def run(self, image: NDArray[np.float32]) -> Seen:
        """What the network says of an image. Raises InferenceError or BundleError."""


def open_network(
    bundle: Bundle, precision: str, view: View, workers: Workers, execution: Execution = ON_CPU
) -> Network:
    """The network of a bundle for a view of one of its sensors; raises what `ImageNet.of` does. One of points has no
    other provider than the processor, and no other precision than float32."""
    if view.cylinder is None:
        return ImageNet.of(bundle, precision, view, threads=workers.threads, execution=execution)
    path = bundle.image_net(precision)
    others = [name for name in map(provider_name, execution.providers or ()) if name != CPU]
    if others:
        reason = f"{path}: a network of points runs on the processor, not on {others[0]}"
        if not execution.allow_fallback:
            raise ProviderError(f"{reason}; leave it out")
        warnings.warn(reason, MosWarning, stacklevel=4)
    return CylinderNet(bundle.cylinder_net(), view.cylinder, bundle.manifest.features, workers)
