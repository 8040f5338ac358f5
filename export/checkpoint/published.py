"""What a checkpoint is: one of ours, or one that was published; told by its keys and shapes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from export.checkpoint.key_map import UNUSED_PREFIXES, head_modules, image_modules, published_names
from mos_model.networks.checkpoint import is_ours, load_state, parse
from mos_model.networks.config import ModelConfig
from mos_model.networks.point_head import PointHead
from mos_model.networks.registry import named_config
from runtime.bundle.head_shape import FULL, LITE, PointHeadConfig
from runtime.bundle.residual import Residual
from runtime.errors import CheckpointError, SettingError

OURS = "checkpoint of lidar-mos"
PUBLISHED = ("lmnet", "b", "c", "d", "e", "v1", "v2", "v2-lite")

State = Mapping[str, Any]


@dataclass(frozen=True)
class Source:
    """A checkpoint that has been understood: modules in float32 on the CPU, in evaluation mode."""

    origin: str  # in words
    config: ModelConfig
    image_net: nn.Module
    point_head: PointHead | None
    dropped: tuple[str, ...] = ()  # keys that the network does not use
    training: Mapping[str, Any] = field(default_factory=dict)  # what our trainer wrote
    trained: bool = True


def understand(content: Any, path: Path, network: str | None = None) -> Source:
    """Build the modules of what `read_tensors` returned.

    `network` (one of PUBLISHED) says what keys and shapes cannot: the pooling. Without it a network with
    MetaKernel has SoftPool (v1). b to e and v1 speak of the image network: a point head in the file comes
    along. Raises SettingError on an unknown `network`, and CheckpointError where the file is not of
    `network`, or lacks, adds or misshapes a tensor: all of them are named.
    """
    if network is not None and network not in PUBLISHED:
        raise SettingError(f"network must be one of {', '.join(PUBLISHED)}, not {network!r}")
    if is_ours(content):
        return _ours(content, path, network)
    origin, image_state, head_state = _parts(content, path)
    config = _recognise(image_state, head_state, network, path)
    image_net, point_head = config.build_image_network(), config.build_point_head()
    unused = UNUSED_PREFIXES if config.kind == "dual" else ()
    dropped = tuple(key for key in image_state if key.startswith(unused))
    used = {key: value for key, value in image_state.items() if key not in set(dropped)}
    names = published_names(image_net.state_dict(), image_modules(config.kind))
    load_state(image_net, used, f"{path}: image network", names)
    if point_head is not None and config.point_head is not None:
        names = published_names(point_head.state_dict(), head_modules(config.point_head))
        load_state(point_head, head_state, f"{path}: point head", names)
        point_head.eval()
    return Source(origin, config, image_net.eval(), point_head, dropped)


def _ours(content: dict[str, Any], path: Path, network: str | None) -> Source:
    if network is not None:
        raise CheckpointError(f"{path}: says itself which network it holds; leave out {network} (`network`)")
    stored = parse(content, str(path))
    if (stored.point_head is None) != (stored.config.point_head is None):
        raise CheckpointError(f"{path}: its configuration and its weights disagree about a point head")
    found, training = stored.modules(), stored.training
    trained = bool(training.get("trained", training.get("step", 0)))
    return Source(OURS, found.config, found.image_net, found.point_head, (), training, trained)


def _parts(content: Mapping[Any, Any], path: Path) -> tuple[str, State, State | None]:
    """Kind of file, weights of the image network, and those of the point head."""
    if "main_state_dict" in content or "refine_state_dict" in content:
        main, refine = (_state(content, key, path) for key in ("main_state_dict", "refine_state_dict"))
        return "published stage 2", main, refine
    if "state_dict" in content:
        return "published stage 1", _state(content, "state_dict", path), None
    if content and all(isinstance(value, Tensor) for value in content.values()):
        return "bare state dict", _state({"state_dict": content}, "state_dict", path), None
    found = ", ".join(map(str, list(content)[:10])) or "nothing"
    raise CheckpointError(
        f"{path}: holds no known kind of checkpoint: expected image_net with config (this package), "
        f"state_dict, main_state_dict with refine_state_dict, or weights alone, but found {found}"
    )


def _state(content: Mapping[Any, Any], key: str, path: Path) -> State:
    """A state dict, without the prefix that parallel training puts before every key."""
    state = content.get(key)
    if not isinstance(state, Mapping) or not state or not all(isinstance(name, str) for name in state):
        raise CheckpointError(f"{path}: {key} should be a mapping from names to tensors, but is not")
    prefixed = all(name.startswith("module.") for name in state)
    return {name.removeprefix("module."): value for name, value in state.items()} if prefixed else state


def _recognise(image: State, head: State | None, network: str | None, path: Path) -> ModelConfig:
    """The configuration that the keys and shapes speak of."""
    try:
        width = _size(image, "downCntx.conv1.weight", 0, 32)
        changes: dict[str, Any] = {} if head is None else {"point_head": _head_config(head, width)}
        name = _image_name(image, network)
        if name == "lmnet":
            images = _size(image, "downCntx.conv1.weight", 1, 13) - 5
        else:
            images = _size(image, "RI_downCntx.conv1.weight", 1, 8)
        changes["residual"] = Residual(lags=tuple(range(1, images + 1)))
        if name == "v1" and head is not None:
            name = "v2-lite" if _depth(head) == len(LITE.down) else "v2"
        if network in ("v2", "v2-lite") and network != name:
            raise CheckpointError(f"it is {name}, not {network}")
        return named_config(name, width, **changes)
    except (CheckpointError, SettingError) as error:
        raise CheckpointError(f"{path}: {error}") from error


def _image_name(state: State, network: str | None) -> str:
    """Which row of the paper's ablation the image network is: lmnet, b, c, d or v1."""
    if _has(state, "logits3.") or _has(state, "RI_"):
        possible: tuple[str, ...] = ("v1", "e", "d", "v2", "v2-lite") if _has(state, "metaConv.") else ("b", "c")
    elif _has(state, "logits."):
        possible = ("lmnet",)
    else:
        raise CheckpointError(
            f"no network of this family: neither logits3 nor logits among its {len(state)} tensors "
            f"({', '.join(list(state)[:5])}, ...)"
        )
    if network is None and possible == ("b", "c"):
        raise CheckpointError("without MetaKernel it may be b (average pooling) or c: say which (`network='b'`)")
    name = possible[0] if network is None else network
    if name not in possible:
        raise CheckpointError(f"its tensors are those of {' or '.join(possible)}, not of {name}")
    return "v1" if name in ("e", "v2", "v2-lite") else name


def _head_config(state: State, width: int) -> PointHeadConfig:
    """Full or lite by the number of stages, channels by the shapes."""
    kinds = {len(kind.down): kind for kind in (FULL, LITE)}
    if _depth(state) not in kinds:
        raise CheckpointError(f"a point head of {_depth(state)} stages: the full one has 4, the lite one 2")
    kind = kinds[_depth(state)]
    down = (_size(state, f"stage{n}.2.net.3.kernel", 2, c) for n, c in enumerate(kind.down, 1))
    up = (_size(state, f"up{n}.1.1.net.3.kernel", 2, c) for n, c in enumerate(kind.up, 1))
    return replace(kind, in_channels=width, down=tuple(down), up=tuple(up))


def _depth(head: State) -> int:
    return len({key.split(".")[0] for key in head if key.startswith("stage")})


def _has(state: State, prefix: str) -> bool:
    return any(key.startswith(prefix) for key in state)


def _size(state: State, key: str, axis: int, default: int) -> int:
    """Length of one axis; the usual one where it cannot be seen, so that loading names whatever is wrong."""
    value = state.get(key)
    return value.shape[axis] if isinstance(value, Tensor) and value.ndim > axis else default
