"""ONNX Runtime sessions: the one place that imports it.

ONNX Runtime, from the moment of its import, writes a device id below the home folder and reports its use over the
network. `ORT_DISABLE_TELEMETRY=1` ends both; it is set here unless the user has set it, to whatever.
"""

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from runtime.errors import BundleError, MosWarning, ProviderError, SettingError

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
import onnxruntime as ort

Provider = str | tuple[str, dict[str, Any]]

CPU = "CPUExecutionProvider"
SESSION_OPTIONS = {
    # Threads wait for their next piece of a run without sleeping, but not after the run, where they would starve the
    # other kernels. With "rt" and 2 threads 1, 2 and 12 % less time a scan than if they always sleep, in three runs.
    "session.intra_op.allow_spinning": "1",
    "session.force_spinning_stop": "1",
    "session.disable_quant_qdq": "1",  # the INT8 graph has its integer operations; the search would only copy work
}
# The INT8 graph has its channels where they should be; where a size is open, this would turn its features once more.
LEFT_OUT = "TransposeOptimizer"
PACKAGES = {  # what brings a provider
    "CUDAExecutionProvider": "onnxruntime-gpu",
    "TensorrtExecutionProvider": "onnxruntime-gpu",
    "OpenVINOExecutionProvider": "onnxruntime-openvino",
    "DmlExecutionProvider": "onnxruntime-directml",
    "CoreMLExecutionProvider": "onnxruntime (macOS)",
    "ROCMExecutionProvider": "onnxruntime-rocm",
    "MIGraphXExecutionProvider": "onnxruntime-rocm",
}


@dataclass(frozen=True)
class Execution:
    """On what ONNX Runtime runs a model, and how."""

    providers: Sequence[Provider] | None = None  # the preferred first, each a name or (name, options); None: the CPU
    allow_fallback: bool = False  # use the CPU, with a warning, where one of them is not available; else: an error
    # entries for ONNX Runtime's session configuration, such as {"session.intra_op.allow_spinning": "0"}; see
    # `SESSION_OPTIONS` for what they are here
    session_options: Mapping[str, str] = field(default_factory=dict)


ON_CPU = Execution()


class Session:
    """One of ONNX Runtime, which is opened anew in a process that was forked: its threads are not there."""

    def __init__(self, open_it: Callable[[], Any]) -> None:
        self._open, self._process, self._session = open_it, os.getpid(), open_it()

    def run(self, names: Sequence[str] | None, feeds: Mapping[str, Any]) -> list[Any]:
        """Outputs of these names, None: all."""
        if self._process != os.getpid():
            _LEFT.append(self._session)  # to end it would be to wait for its threads
            self._session, self._process = self._open(), os.getpid()
        found: list[Any] = self._session.run(names, feeds)
        return found

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)


_LEFT: list[Any] = []


def open_session(
    model: str | Path | bytes,
    *,
    threads: int,
    execution: Execution = ON_CPU,
    sizes: Mapping[str, int] | None = None,
) -> Session:
    """An ONNX Runtime session over a model: its path, or its bytes.

    threads: of the CPU provider.
    sizes: of dimensions that the model leaves open, by their names: what follows from them is then computed once.

    Raises ProviderError, SettingError for options that ONNX Runtime refuses, or BundleError for a broken model.
    """
    wanted = _available(execution.providers or [CPU], execution.allow_fallback)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.enable_mem_pattern = False  # its one large block would come on top of the arena's: half the memory
    options.log_severity_level = 3
    try:
        for key, value in {**SESSION_OPTIONS, **execution.session_options}.items():
            options.add_session_config_entry(key, value)
    except Exception as error:
        raise SettingError(f"session option {key}={value!r} is refused by ONNX Runtime: {error}") from error
    for dimension, size in (sizes or {}).items():
        options.add_free_dimension_override_by_name(dimension, size)
    session = Session(lambda: _session(model, options, wanted, [LEFT_OUT] if sizes else []))
    for name in map(provider_name, wanted):
        if name not in session.get_providers():  # ONNX Runtime goes on without one whose libraries are missing
            reason = f"{name} is installed but could not start (are its libraries there?)"
            _fall_back(reason, name, execution.allow_fallback)
    return session


def _session(model: str | Path | bytes, options: Any, providers: list[Any], left_out: list[str]) -> Any:
    """An ONNX Runtime session. Raises ProviderError where a provider fails but the CPU loads the model."""
    source, name = (model, "the model") if isinstance(model, bytes) else (str(model), str(model))
    try:
        settings = {"enable_fallback": 0, "disabled_optimizers": left_out}
        return ort.InferenceSession(source, options, providers=providers, **settings)
    except Exception as error:  # ONNX Runtime's errors share no base but Exception
        reason = error
    try:
        ort.InferenceSession(source, options, providers=[CPU])
    except Exception as error:
        raise BundleError(f"{name}: ONNX Runtime cannot load it: {error}") from error
    raise ProviderError(f"{', '.join(map(provider_name, providers))} cannot run {name}: {reason}") from reason


def provider_name(provider: Provider) -> str:
    """The name of a provider that is given with or without options."""
    return str(provider if isinstance(provider, str) else provider[0])


def available_providers() -> list[str]:
    """Execution providers of the installed ONNX Runtime."""
    return list(ort.get_available_providers())


def _available(providers: Sequence[Any], allow_fallback: bool) -> list[Any]:
    """Those of `providers` that are there, the CPU last."""
    have = available_providers()
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
        raise ProviderError(f"{reason}; {cure}, or allow the fallback to the CPU (`allow_fallback=True`)")
    warnings.warn(f"{reason}; running without it. To use it, {cure}", MosWarning, stacklevel=6)
