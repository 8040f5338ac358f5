"""What published checkpoints call the weights of the networks: our name -> theirs.

The maps are of modules (convolutions, BatchNorms); a tensor of a module (weight, running_mean, ...) is called the same.
"""

from collections.abc import Iterable, Mapping
from typing import TypeVar

from runtime.bundle.head_shape import PointHeadConfig
from runtime.head.weights import layers

T = TypeVar("T")

# Within the blocks; numbers follow the order of computation.
CONTEXT = {
    "shortcut": "conv1",
    "first.conv": "conv2",
    "first.norm": "bn1",
    "second.conv": "conv3",
    "second.norm": "bn2",
}
ENCODER = CONTEXT | {"third.conv": "conv4", "third.norm": "bn3", "join.conv": "conv5", "join.norm": "bn4"}
DECODER = {
    "first.conv": "conv1",
    "first.norm": "bn1",
    "second.conv": "conv2",
    "second.norm": "bn2",
    "third.conv": "conv3",
    "third.norm": "bn3",
    "join.conv": "conv4",
    "join.norm": "bn4",
}
META_KERNEL = {"weigh1": "conv1", "weigh2": "conv2", "join": "conv1x1"}

BLOCKS = {  # of the image networks: theirs, and what is within it
    "context.0": ("downCntx", CONTEXT),
    "context.1": ("downCntx2", CONTEXT),
    "context.2": ("downCntx3", CONTEXT),
    "meta_kernel": ("metaConv", META_KERNEL),
    **{f"encoder.{i}": (f"resBlock{i + 1}", ENCODER) for i in range(4)},
    "middle": ("resBlock5", ENCODER),
    **{f"decoder.{i}": (f"upBlock{i + 1}", DECODER) for i in range(4)},
    "motion_context": ("RI_downCntx", CONTEXT),
    **{f"motion_encoder.{i}": (f"RI_resBlock{i + 1}", ENCODER) for i in range(4)},
}
SCALES = ("conv1", "layer0", "layer1", "layer2", "layer3")  # of the attention: 1/1, 1/2, 1/4, 1/8, 1/16
LOGITS = {"lmnet": "logits", "dual": "logits3"}  # by kind of network

# Tensors of published dual-branch checkpoints that the published network never uses.
UNUSED_PREFIXES = (
    "RI_resBlock5.",
    "RI_upBlock1.",
    "RI_upBlock2.",
    "RI_upBlock3.",
    "RI_upBlock4.",
    "conv1x1_layer4_",
)

HEAD_LAYERS = {  # of the point head, by the end of their names: the convolution, and the BatchNorm after it
    "conv1": ("net.0", "net.1"),
    "conv2": ("net.3", "net.4"),
    "shortcut": ("downsample.0", "downsample.1"),
}


def image_modules(kind: str) -> dict[str, str]:
    """Modules of an image network of a kind that is published ("lmnet" or "dual")."""
    modules = {
        f"{ours}.{part}": f"{theirs}.{name}" for ours, (theirs, parts) in BLOCKS.items() for part, name in parts.items()
    }
    for i, scale in enumerate(SCALES):
        for gate in ("spatial", "channel_wise"):
            modules[f"attention.{i}.{gate}"] = f"conv1x1_{scale}_{gate}"
    return modules | {"logits": LOGITS[kind]}


def head_modules(config: PointHeadConfig) -> dict[str, str]:
    """Modules of a point head."""
    modules: dict[str, str] = {}
    for layer in layers(config):
        block, _, last = layer.name.rpartition(".")
        if last in HEAD_LAYERS:
            conv, norm = (f"{block}.{name}" for name in HEAD_LAYERS[last])
        elif layer.name.startswith(("stage", "up")):
            conv, norm = f"{layer.name}.net.0", f"{layer.name}.net.1"
        else:  # stem, point transforms, classifier
            conv, norm = f"{layer.name}.0", f"{layer.name}.1"
        modules |= {layer.name: conv, f"{layer.name}.norm": norm}
    return modules


def under_our_names(state: Mapping[str, T], modules: Mapping[str, str]) -> dict[str, T]:
    """A published state dict with the keys of our network, without what our network does not have."""
    ours = {theirs: name for name, theirs in modules.items()}
    parts = {key: key.rpartition(".") for key in state}
    return {f"{ours[module]}.{tensor}": state[key] for key, (module, _, tensor) in parts.items() if module in ours}


def published_names(keys: Iterable[str], modules: Mapping[str, str]) -> dict[str, str]:
    """What the tensors `keys` of a network of ours are called in a published state dict."""
    found = {}
    for key in keys:
        module, _, tensor = key.rpartition(".")
        found[key] = f"{modules[module]}.{tensor}"
    return found
