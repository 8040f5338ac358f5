"""The image network on ONNX Runtime."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.loading import Bundle
from runtime.bundle.view import View
from runtime.classes import CLASSES
from runtime.compute.sessions import ON_CPU, Execution, open_session
from runtime.errors import BundleError, InferenceError

LARGEST = 1.001  # probability: a sum of three may round
HEIGHT, WIDTH = "height", "width"  # of the image: what a file that leaves them open calls them


class Seen(NamedTuple):
    """What the image network says of an image."""

    probabilities: NDArray[np.float32]  # (3, H, W) of unlabelled, static, moving
    features: NDArray[np.float32]  # (c, H, W / s); s neighbours in a row share theirs: 1, but 2 for "rt"


class ImageNet:
    """An ONNX session. Image in; probabilities and features out."""

    def __init__(
        self,
        path: str | Path,
        size: tuple[int, int] | None = None,
        *,
        threads: int,
        execution: Execution = ON_CPU,
    ) -> None:
        """size: height and width of the images, for a file that leaves them open.

        threads, execution: see `open_session`, which raises what this does.
        """
        sizes = None if size is None else dict(zip((HEIGHT, WIDTH), size, strict=True))
        self._session = open_session(path, threads=threads, execution=execution, sizes=sizes)
        self.providers: list[str] = self._session.get_providers()
        inputs, outputs = described(self._session.get_inputs()), described(self._session.get_outputs())
        if set(inputs) != {"image"} or not {"probabilities", "features"} <= set(outputs):
            raise BundleError(f"{path}: is no image network: inputs {sorted(inputs)}, outputs {sorted(outputs)}")
        for name, shape in (inputs | outputs).items():
            if len(shape) != 4:
                raise BundleError(f"{path}: is no image network: {name} is of shape {shape}, not of four dimensions")
        self._path = path
        self.shape: tuple[int | str, ...] = inputs["image"]  # (1, channels, H, W); names stand for what is open
        channels = outputs["features"][1]
        if not isinstance(channels, int):
            raise BundleError(f"{path}: does not say how many channels its features have")
        self.features = channels  # of the feature map

    @classmethod
    def of(cls, bundle: Bundle, precision: str = "auto", view: View | None = None, **session: Any) -> "ImageNet":
        """The image network of a bundle, for a view of its sensors; None: of the first that the bundle lists.

        Raises BundleError where it takes no images of that size, or does not fit the manifest.
        """
        path, manifest = bundle.image_net(precision), bundle.manifest
        own = manifest.view(manifest.sensor)
        shape = (own if view is None else view).shape
        net, want = cls(path, shape[1:], **session), (1, *shape)
        if net.shape != want:
            if net.shape == (1, *own.shape):
                reason = f"its network is for images of {own.shape[1]} x {own.shape[2]}; export its checkpoint again"
                raise BundleError(f"{path}: takes no image of {shape[1]} x {shape[2]}: {reason}")
            raise BundleError(f"{path}: takes an image of shape {net.shape}, the manifest says {want}")
        if net.features != manifest.features:
            raise BundleError(f"{path}: gives {net.features} features, the manifest says {manifest.features}")
        return net

    def run(self, image: NDArray[np.float32]) -> Seen:
        """What the network says of an image (channels, H, W) f32.

        Raises InferenceError where the image does not fit, the network fails or gives values that are not finite,
        BundleError where what it gives is nothing that an image network may give.
        """
        if image.dtype != np.float32 or (1, *image.shape) != self.shape:
            raise InferenceError(f"the network takes {self.shape[1:]} float32, not {image.shape} {image.dtype}")
        try:
            outputs = self._session.run(["probabilities", "features"], {"image": image[None]})
        except Exception as error:
            raise InferenceError(f"the image network failed: {error}") from error
        probabilities, features = outputs
        height, width = image.shape[1:]
        columns = features.shape[-1] if features.ndim else 0
        if probabilities.shape != (1, len(CLASSES), height, width) or probabilities.dtype != np.float32:
            self._refuse("probabilities", probabilities, f"(1, {len(CLASSES)}, {height}, {width})")
        fits = features.shape == (1, self.features, height, columns) and columns and width % columns == 0
        if not fits or features.dtype != np.float32:
            self._refuse("features", features, f"(1, {self.features}, {height}, {width} or a part of it)")
        low, high = probabilities.min(), probabilities.max()  # NaN where there is any
        if low < 0 or high > LARGEST:
            raise BundleError(f"{self._path}: gives probabilities of {low:.3g} to {high:.3g}; get the bundle again")
        if not (np.isfinite(low + high) and _finite(features)):
            raise InferenceError(
                "the image network gave values that are not finite; the scan holds values far out of its training "
                "data (remission? coordinates not in metres?), or the weights are damaged"
            )
        return Seen(probabilities[0], features[0])

    def _refuse(self, name: str, given: NDArray[np.generic], wanted: str) -> NoReturn:
        raise BundleError(
            f"{self._path}: gives {name} of shape {given.shape} {given.dtype}, not {wanted} float32; "
            f"get the bundle again"
        )


def described(values: Sequence[Any]) -> dict[str, tuple[int | str, ...]]:
    """Shapes of inputs or outputs of a session, by their names."""
    return {value.name: tuple(value.shape) for value in values}


def _finite(values: NDArray[np.float32]) -> bool:
    """Whether all values are finite. A sum meets each of them, so only where it is not is a closer look needed."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(values.sum())) or bool(np.isfinite(values).all())
