"""The image network on ONNX Runtime."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from runtime.bundle.manifest import Bundle
from runtime.errors import BundleError, InferenceError, MosWarning, ProviderError, SettingError

Provider = str | tuple[str, dict[str, Any]]

CPU = "CPUExecutionProvider"
SESSION_OPTIONS = {
    # Threads wait for their next piece of a run without sleeping, but not after the run, where they would starve the
    # other kernels. With "rt" and 2 threads 1, 2 and 12 % less time a scan than if they always sleep, in three runs.
    "session.intra_op.allow_spinning": "1",
    "session.force_spinning_stop": "1",
    "session.disable_quant_qdq": "1",  # the INT8 graph has its integer operations; the search would only copy work
}
PACKAGES = {  # what brings a provider
    "CUDAExecutionProvider": "onnxruntime-gpu",
    "TensorrtExecutionProvider": "onnxruntime-gpu",
    "OpenVINOExecutionProvider": "onnxruntime-openvino",
    "DmlExecutionProvider": "onnxruntime-directml",
    "CoreMLExecutionProvider": "onnxruntime (macOS)",
    "ROCMExecutionProvider": "onnxruntime-rocm",
    "MIGraphXExecutionProvider": "onnxruntime-rocm",
}


class ImageNet:
    """An ONNX session. Image in; probabilities and features out."""

    def __init__(
        self,
        path: str | Path,
        *,
        threads: int,
        providers: Sequence[Provider] | None = None,
        allow_fallback: bool = False,
        session_options: Mapping[str, str] | None = None,
    ) -> None:
        """threads, providers, allow_fallback, session_options: see `open_session`, which raises what this does."""
        self._session = open_session(
            path, threads=threads, providers=providers, allow_fallback=allow_fallback, session_options=session_options
        )
        self.providers: list[str] = self._session.get_providers()
        inputs = {value.name: tuple(value.shape) for value in self._session.get_inputs()}
        outputs = {value.name: tuple(value.shape) for value in self._session.get_outputs()}
        if set(inputs) != {"image"} or not {"probabilities", "features"} <= set(outputs):
            raise BundleError(f"{path}: is no image network: inputs {sorted(inputs)}, outputs {sorted(outputs)}")
        self.shape: tuple[int, ...] = inputs["image"]  # (1, channels, H, W)
        self.features: int = outputs["features"][1]  # channels of the feature map

    @classmethod
    def of(cls, bundle: Bundle, precision: str = "auto", **settings: Any) -> "ImageNet":
        """The image network of a bundle. Raises BundleError where it does not fit the manifest."""
        path, manifest = bundle.image_net(precision), bundle.manifest
        net = cls(path, **settings)
        want = (1, 5 + len(manifest.residual.lags), manifest.sensor.height, manifest.sensor.width)
        if net.shape != want:
            raise BundleError(f"{path}: takes an image of shape {net.shape}, the manifest says {want}")
        if net.features != manifest.features:
            raise BundleError(f"{path}: gives {net.features} features, the manifest says {manifest.features}")
        return net

    def run(self, image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Probabilities (3, H, W) and features (c, H, W / s) of an image (channels, H, W), all f32.

        s neighbouring pixels of a row share their features; 1 but for "rt", whose stems halve the width.
        Raises InferenceError where the image does not fit, the network fails or gives values that are not finite.
        """
        if image.dtype != np.float32 or (1, *image.shape) != self.shape:
            raise InferenceError(f"the network takes {self.shape[1:]} float32, not {image.shape} {image.dtype}")
        try:
            outputs = self._session.run(["probabilities", "features"], {"image": image[None]})
        except Exception as error:
            raise InferenceError(f"the image network failed: {error}") from error
        probabilities, features = outputs
        if not (_finite(probabilities) and _finite(features)):
            raise InferenceError(
                "the image network gave values that are not finite; the scan holds values far out of its training "
                "data (remission? coordinates not in metres?), or the weights are damaged"
            )
        return probabilities[0], features[0]


def open_session(
    path: str | Path,
    *,
    threads: int,
    providers: Sequence[Provider] | None = None,
    allow_fallback: bool = False,
    session_options: Mapping[str, str] | None = None,
) -> Any:
    """An ONNX Runtime session over the model at `path`.

    threads: of the CPU provider.
    providers: execution providers, the preferred first, each a name or (name, options); None: the CPU.
    allow_fallback: use the CPU, with a warning, where one of them is not available; else that is an error.
    session_options: entries for ONNX Runtime's session configuration, such as
        {"session.intra_op.allow_spinning": "0"} (see `SESSION_OPTIONS` for what they are here).

    Raises ProviderError, SettingError for options that ONNX Runtime refuses, or BundleError for a broken file.
    """
    wanted = _available(providers or [CPU], allow_fallback)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.enable_mem_pattern = False  # its one large block would come on top of the arena's: half the memory
    options.log_severity_level = 3
    try:
        for key, value in {**SESSION_OPTIONS, **(session_options or {})}.items():
            options.add_session_config_entry(key, value)
    except Exception as error:
        raise SettingError(f"session option {key}={value!r} is refused by ONNX Runtime: {error}") from error
    session = _session(path, options, wanted)
    for name in map(provider_name, wanted):
        if name not in session.get_providers():  # ONNX Runtime goes on without one whose libraries are missing
            _fall_back(f"{name} is installed but could not start (are its libraries there?)", name, allow_fallback)
    return session


def _session(path: str | Path, options: Any, providers: list[Any]) -> Any:
    """An ONNX Runtime session. Raises ProviderError where a provider fails but the CPU loads the file."""
    try:
        return ort.InferenceSession(str(path), options, providers=providers, enable_fallback=0)
    except Exception as error:  # ONNX Runtime's errors share no base but Exception
        reason = error
    try:
        ort.InferenceSession(str(path), options, providers=[CPU])
    except Exception as error:
        raise BundleError(f"{path}: ONNX Runtime cannot load it: {error}") from error
    raise ProviderError(f"{', '.join(map(provider_name, providers))} cannot run {path}: {reason}") from reason


def _finite(values: NDArray[np.float32]) -> bool:
    """Whether all values are finite. A sum meets each of them, so only where it is not is a closer look needed."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(values.sum())) or bool(np.isfinite(values).all())


def provider_name(provider: Provider) -> str:
    """The name of a provider that is given with or without options."""
    return str(provider if isinstance(provider, str) else provider[0])


def _available(providers: Sequence[Any], allow_fallback: bool) -> list[Any]:
    """Those of `providers` that are there, the CPU last."""
    have = ort.get_available_providers()
    kept = []
    for provider in providers:
        name = provider_name(provider)
        if name in have:
            kept.append(provider)
        else:
            _fall_back(f"{name} is not in the installed ONNX Runtime (it has {', '.join(have)})", name, allow_fallback)
    return kept if CPU in map(provider_name, kept) else [*kept, CPU]


def _fall_back(reason: str, provider: str, allowed: bool) -> None:
    package = PACKAGES.get(provider)
    cure = f"install {package} in place of onnxruntime" if package else "choose one of those"
    if not allowed:
        raise ProviderError(f"{reason}; {cure}, or allow the fallback to the CPU (allow_fallback=True)")
    warnings.warn(f"{reason}; running without it. To use it, {cure}", MosWarning, stacklevel=6)
