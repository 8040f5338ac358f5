"""What a checkpoint is: one of ours, or one that was published; told by its keys and shapes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from mos_model.checkpoint import FORMAT, load_state
from mos_model.config import ModelConfig, named_config
from mos_model.network import UNUSED_PREFIXES, build_image_network, build_point_head
from runtime.errors import CheckpointError, SettingError
from runtime.head_config import FULL, LITE, PointHeadConfig
from runtime.sensor import HISTORY, Residual

META_KERNEL_ROWS = ("d", "e", "v1", "v2", "v2-lite")  # the names that have a MetaKernel


@dataclass(frozen=True)
class Source:
    """A checkpoint that has been understood: modules in float32 on the CPU, in evaluation mode."""

    kind: str  # in words
    config: ModelConfig
    image_net: nn.Module
    point_head: nn.Module | None
    dropped: tuple[str, ...] = ()  # keys that the network does not use
    training: Mapping[str, Any] = field(default_factory=dict)  # what our trainer wrote
    trained: bool = True


def understand(content: Any, path: Path, network: str | None = None) -> Source:
    """Build the modules of what `read_tensors` returned.

    `network` names a published network (`mos_model.config.NAMES`) where its file leaves that open: SoftPool and average
    pooling have no weights. Raises CheckpointError naming every tensor that is missing, extra or misshapen.
    """
    if isinstance(content, dict) and {"format", "config", "image_net"} <= content.keys():
        return _ours(content, path, network)
    kind, image_state, head_state = _published_parts(content, path)
    config = _published_config(image_state, head_state, path, network)
    image_net, point_head = build_image_network(config), build_point_head(config)
    dropped = load_state(image_net, image_state, f"{path}: image network", UNUSED_PREFIXES)
    if point_head is not None and head_state is not None:
        load_state(point_head, head_state, f"{path}: point head")
        point_head.eval()
    return Source(kind, config, image_net.eval(), point_head, tuple(dropped))


def _ours(content: dict[str, Any], path: Path, network: str | None) -> Source:
    if network is not None:
        raise CheckpointError(f"{path}: says itself which network it holds; leave out --network {network}")
    if content["format"] != FORMAT:
        raise CheckpointError(f"{path}: format {content['format']!r}, but this version reads format {FORMAT}")
    try:
        config = ModelConfig.from_dict(content["config"])
    except SettingError as error:
        raise CheckpointError(f"{path}: its configuration does not fit this version: {error}") from error
    if ("point_head" in content) != (config.point_head is not None):
        raise CheckpointError(f"{path}: its configuration and its weights disagree about a point head")
    image_net, point_head = build_image_network(config), build_point_head(config)
    load_state(image_net, content["image_net"], f"{path}: image network")
    if point_head is not None:
        load_state(point_head, content["point_head"], f"{path}: point head")
        point_head.eval()
    training = content.get("training") or {}
    trained = bool(training.get("trained", training.get("step", 0)))
    return Source("checkpoint of lidar-mos", config, image_net.eval(), point_head, (), training, trained)


def _published_parts(content: Any, path: Path) -> tuple[str, dict[str, Tensor], dict[str, Tensor] | None]:
    """Kind in words, state dict of the image network, state dict of the point head."""
    if isinstance(content, dict):
        if "main_state_dict" in content:
            if "refine_state_dict" not in content:
                raise CheckpointError(
                    f"{path}: has a main_state_dict but no refine_state_dict (the point head)"
                )
            head = _state(content["refine_state_dict"], path, "refine_state_dict")
            return "published stage 2", _state(content["main_state_dict"], path, "main_state_dict"), head
        if "state_dict" in content:
            return "published stage 1", _state(content["state_dict"], path, "state_dict"), None
        if content and all(isinstance(value, Tensor) for value in content.values()):
            return "bare state dict", _state(content, path, "content"), None
    held = (
        f"it holds {', '.join(map(str, list(content)[:8]))}"
        if isinstance(content, dict) and content
        else "it is empty"
    )
    raise CheckpointError(
        f"{path}: not a checkpoint of this network: neither state_dict, nor main_state_dict and refine_state_dict ({held})"
    )


def _state(values: Any, path: Path, what: str) -> dict[str, Tensor]:
    """Tensors under their plain names (training on several GPUs puts `module.` before each)."""
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        raise CheckpointError(f"{path}: {what} is no state dict")
    return {key.removeprefix("module."): value for key, value in values.items()}


def _published_config(
    image: Mapping[str, Any], head: Mapping[str, Any] | None, path: Path, network: str | None
) -> ModelConfig:
    width, inputs = _conv_shape(image, "downCntx.conv1.weight", path)[:2]
    one_branch = "logits.weight" in image and "logits3.weight" not in image
    lags = inputs - 5 if one_branch else _conv_shape(image, "RI_downCntx.conv1.weight", path)[1]
    if not 1 <= lags <= HISTORY:
        raise CheckpointError(f"{path}: takes {lags} residual images, but there are 1 to {HISTORY}")
    name = _published_name(one_branch, any(key.startswith("metaConv.") for key in image), path, network)
    residual = Residual(lags=tuple(range(1, lags + 1)))
    point_head = _published_head(head, width) if head is not None else None
    if point_head is not None and name in ("e", "v1", "v2", "v2-lite"):
        name = "v2" if "stage3.0.net.0.kernel" in (head or {}) else "v2-lite"
    elif point_head is None and name in ("e", "v2", "v2-lite"):
        name = "v1"
    return replace(named_config(name, width, residual=residual, point_head=None), point_head=point_head)


def _published_name(one_branch: bool, meta_kernel: bool, path: Path, network: str | None) -> str:
    """Which row of the paper's table; `network` decides where the tensors do not."""
    if one_branch:
        fitting, default = ("lmnet",), "lmnet"
    elif meta_kernel:
        fitting, default = META_KERNEL_ROWS, "v1"
    else:
        fitting, default = ("b", "c"), None
    chosen = network or default
    if chosen is None:
        raise CheckpointError(
            f"{path}: is row b (average pooling) or c (SoftPool) of the paper's table, which its tensors do not tell; "
            "say so by --network b or --network c"
        )
    if chosen not in fitting:
        raise CheckpointError(f"{path}: its tensors are those of {' or '.join(fitting)}, not of {chosen!r}")
    return chosen


def _published_head(state: Mapping[str, Any], width: int) -> PointHeadConfig:
    """The full head has a third stage, the lite one has two."""
    return replace(FULL if "stage3.0.net.0.kernel" in state else LITE, in_channels=width)


def _conv_shape(state: Mapping[str, Any], key: str, path: Path) -> tuple[int, ...]:
    weight = state.get(key)
    if not isinstance(weight, Tensor) or weight.ndim != 4:
        raise CheckpointError(
            f"{path}: {key} is missing or is no kernel; this is no image network of the paper"
        )
    return tuple(weight.shape)
