"""Checkpoint -> bundle, whole or not at all."""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from export.bundle.cylinder_weights import cylinder_arrays
from export.bundle.head_weights import head_arrays, write_arrays, write_point_head
from export.bundle.parity import Parity, check_parity
from export.bundle.write import file_entry, plain, replacing_bundle, rounded_to_half, write_manifest
from export.checkpoint.published import OURS, Source, understand
from export.checkpoint.reader import read_tensors
from export.graph.any_size import any_size
from export.graph.head_graph import head_bytes
from export.graph.image_graph import Outputs, image_bytes
from export.int8.quantise import Settings, quantise
from mos_model.data.dataset import SampleConfig
from mos_model.networks.config import ModelConfig
from runtime.bundle.loading import Bundle, load_bundle
from runtime.bundle.manifest import (
    CYLINDER_NET,
    IMAGE_NET,
    IMAGE_NET_INT8,
    POINT_HEAD,
    POINT_HEAD_ONNX,
    Decision,
    Manifest,
    SensorEntry,
    Tuned,
)
from runtime.errors import CheckpointError, SettingError
from runtime.sensors.registry import find_sensor
from runtime.typed_json import build

STORED = ("float16", "float32")  # how kernels are stored
PRECISIONS = ("float32", "int8")  # how the image network computes


@dataclass(frozen=True)
class Export:
    """What an export did."""

    source: Source
    bundle: Bundle
    parity: Parity


def export_checkpoint(
    checkpoint: Path,
    out: Path,
    network: str | None = None,
    weights: str | None = None,
    height: int | None = None,
    width: int | None = None,
    trained: bool | None = None,
    threads: int = 2,
    point_head_onnx: bool = False,
    precision: str | None = "float32",
    int8: Settings | None = None,
) -> Export:
    """Write the bundle of a checkpoint to `out` and compare the two; a bundle that disagrees is not kept.

    network: name of a published network, where its file leaves open which one it is.
    weights: how kernels are stored, "float32" or "float16"; None: float16 for checkpoints of lidar-mos, else float32.
    height, width: of the range image to export for; None: those of the checkpoint (published ones: 64 x 2048).
    trained: whether the weights are; None: what the checkpoint says.
    point_head_onnx: write the point head as an ONNX graph too, for execution providers on a GPU.
    precision: "int8" writes the image network in 8-bit integers too, beside the float one; None: if the bundle that is
        at `out` has that. int8: how, see `export.int8.quantise`, which raises QuantisationError, SequenceError or
        ScanError.

    Raises CheckpointError, ParityError, SettingError, BundleError (`out` is something else) or OutputError.
    """
    if weights is not None and weights not in STORED:
        raise SettingError(f"weights must be stored as {' or '.join(STORED)}, not {weights!r}")
    if precision is None:
        precision = "int8" if int8 is not None or (out / IMAGE_NET_INT8).is_file() else "float32"
    if precision not in PRECISIONS:
        raise SettingError(f"precision must be {' or '.join(PRECISIONS)}, not {precision!r}")
    if int8 is not None and precision != "int8":
        raise SettingError("a calibration is for precision 'int8'")
    source = understand(read_tensors(checkpoint), checkpoint, network)
    source = replace(source, trained=source.trained if trained is None else trained)
    image = source.config.range_image
    image = replace(
        image, height=image.height if height is None else height, width=image.width if width is None else width
    )
    source = replace(source, config=replace(source.config, range_image=image))
    if precision == "int8" and source.config.view.cylinder is not None:
        raise SettingError(f"{checkpoint}: 8-bit integers are for networks of images, and this one sees points")
    if point_head_onnx and source.point_head is None:
        raise SettingError(f"{checkpoint}: has no point head to write as {POINT_HEAD_ONNX}")
    stored = weights or ("float16" if source.origin == OURS else "float32")
    if stored == "float16":
        rounded_to_half(source.image_net, f"{checkpoint}: image network")
        if source.point_head is not None:
            rounded_to_half(source.point_head, f"{checkpoint}: point head")
    with replacing_bundle(out) as folder:
        _write_networks(folder, source, stored, point_head_onnx)
        manifest = _manifest(folder, source, stored, checkpoint)
        write_manifest(folder, manifest)
        parity = check_parity(load_bundle(folder), source.image_net, source.point_head, threads)
        if precision == "int8":
            manifest = _with_int8(folder, source, manifest, int8 or Settings(threads=threads))
        write_manifest(folder, replace(manifest, parity=parity.to_manifest()))
    return Export(source, load_bundle(out), parity)


def _write_networks(folder: Path, source: Source, precision: str, point_head_onnx: bool) -> None:
    config = source.config
    if config.view.cylinder is None:
        (folder / IMAGE_NET).write_bytes(image_bytes(source.image_net, any_size(config.in_channels)))
    else:
        arrays = cylinder_arrays(source.image_net, config.channels, precision == "float16")
        write_arrays(folder / CYLINDER_NET, arrays)
    if source.point_head is not None and config.point_head is not None:
        half = precision == "float16"
        write_point_head(folder / POINT_HEAD, source.point_head, config.point_head, half)
        if point_head_onnx:
            arrays = head_arrays(source.point_head, config.point_head, half)
            (folder / POINT_HEAD_ONNX).write_bytes(head_bytes(arrays, config.point_head))


def _with_int8(folder: Path, source: Source, manifest: Manifest, settings: Settings) -> Manifest:
    """Write the image network in integers; the manifest with it."""
    done = quantise(
        Outputs(source.image_net),
        (folder / IMAGE_NET).read_bytes(),
        SampleConfig.of(source.config),
        None if manifest.tuned.belief else manifest.sensor.decision.threshold,  # belief adds up; no threshold decides
        source.trained,
        settings,
    )
    path = folder / IMAGE_NET_INT8
    path.write_bytes(done.model)
    files = {**manifest.files, path.name: file_entry(path, "int8")}
    return replace(manifest, files=files, accuracy={**manifest.accuracy, "int8": done.record})


def _manifest(folder: Path, source: Source, precision: str, checkpoint: Path) -> Manifest:
    config, training = source.config, source.training
    features = _channels_of_features(source)
    head = config.point_head
    files = [name for name in (IMAGE_NET, CYLINDER_NET, POINT_HEAD, POINT_HEAD_ONNX) if (folder / name).exists()]
    record = {
        key: value
        for key, value in training.items()
        if key not in ("resume", "accuracy", "threshold", "head_threshold", "decisions", "tuned", "licence")
    }
    return Manifest(
        name=config.name,
        network=config.kind,
        sensors=tuple(_sensors(config, training, checkpoint)),
        residual=config.residual,
        features=features,
        point_head=head,
        files={name: file_entry(folder / name, precision) for name in files},
        weights={
            "source": f"{source.origin}: {checkpoint.name}",
            "sha256": hashlib.sha256(checkpoint.read_bytes()).hexdigest(),
            "trained": source.trained,
            "training": plain(record),
        },
        model=config.to_dict(),
        tuned=build(Tuned, training.get("tuned", {}), f"{checkpoint}: tuned", CheckpointError),
        postprocess=training.get("postprocess", config.postprocess),
        accuracy=plain(training.get("accuracy", {})),
        licence=training.get("licence", "unknown"),
        bird=config.view.bird,
        cylinder=config.view.cylinder,
    )


def _sensors(config: ModelConfig, training: Mapping[str, Any], checkpoint: Path) -> Iterator[SensorEntry]:
    """The sensors of a network, its own first, each with its thresholds."""
    of_all = {name: training.get(name) for name in ("threshold", "head_threshold")}  # one for all, as before
    decisions = training.get("decisions", {})
    for name in (config.sensor, *config.other_sensors):
        sensor = find_sensor(name)
        image = config.range_image if name == config.sensor else sensor.range_image
        decision = build(Decision, decisions.get(name, of_all), f"{checkpoint}: thresholds of {name}", CheckpointError)
        yield SensorEntry(name, image, sensor.reach, decision)


def _channels_of_features(source: Source) -> int:
    """Channels of the feature map, from a pass over a tiny image."""
    config = source.config
    with torch.inference_mode():
        return int(source.image_net(torch.zeros(1, config.in_channels, 16, 16)).features.shape[1])
