"""Which network a bundle holds: the one place that tells those of images from those of points."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.loading import Bundle
from runtime.bundle.view import View
from runtime.compute.sessions import Provider, provider_name
from runtime.compute.workers import Workers
from runtime.errors import ProviderError
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
    bundle: Bundle,
    precision: str,
    view: View,
    workers: Workers,
    *,
    providers: Sequence[Provider] | None = None,
    allow_fallback: bool = False,
    session_options: Mapping[str, str] | None = None,
) -> Network:
    """The network of a bundle for a view of one of its sensors; the rest is as of `ImageNet.of`, which raises what this
    does. One of points has no other provider than the processor, and no other precision than float32."""
    if view.cylinder is None:
        options: dict[str, Any] = {"allow_fallback": allow_fallback, "session_options": session_options}
        return ImageNet.of(bundle, precision, view, threads=workers.threads, providers=providers, **options)
    path = bundle.image_net(precision)
    others = [name for name in map(provider_name, providers or ()) if name != "CPUExecutionProvider"]
    if others and not allow_fallback:
        raise ProviderError(f"{path}: a network of points runs on the processor, not on {others[0]}; leave it out")
    return CylinderNet(bundle.cylinder_net(), view.cylinder, bundle.manifest.features, workers)
