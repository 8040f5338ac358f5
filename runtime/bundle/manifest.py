"""The bundle: a folder with an exported network and the manifest that says all there is to know about it."""

import hashlib
import json
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.head_shape import PointHeadConfig
from runtime.bundle.residual import Residual
from runtime.classes import CLASSES
from runtime.errors import BundleError, MosError
from runtime.sensors.range_image import RangeImage

FORMAT = 1
MANIFEST = "manifest.json"
IMAGE_NET = "image_net.onnx"
IMAGE_NET_INT8 = "image_net_int8.onnx"
POINT_HEAD = "point_head.npz"
POINT_HEAD_ONNX = "point_head.onnx"
NETWORK_FILES = {  # and the precisions that they come in
    IMAGE_NET: ("float32", "float16"),
    IMAGE_NET_INT8: ("int8",),
    POINT_HEAD: ("float32", "float16"),
    POINT_HEAD_ONNX: ("float32", "float16"),
}
POSTPROCESSES = ("none", "knn", "head")
DEFAULT_BUNDLE = "rt"

T = TypeVar("T")


@dataclass(frozen=True)
class FileEntry:
    """One file of a bundle."""

    sha256: str
    bytes: int
    precision: str  # "float32", "float16" (stored so, computed in float32) or "int8"


@dataclass(frozen=True)
class Decision:
    """When a pixel or point counts as moving."""

    threshold: float | None = None  # probability of "moving" from which it is; None: the most likely class
    head_threshold: float | None = None  # the same for probabilities of the point head


@dataclass(frozen=True)
class Manifest:
    """What `manifest.json` holds."""

    name: str
    sensor: RangeImage
    residual: Residual
    features: int  # channels of the feature map
    point_head: PointHeadConfig | None
    files: Mapping[str, FileEntry]
    weights: Mapping[str, Any]  # where they come from: "source", "trained", ...
    model: Mapping[str, Any]  # the configuration that the network was built from
    format: int = FORMAT
    classes: tuple[str, ...] = CLASSES
    decision: Decision = field(default_factory=Decision)
    postprocess: str = "none"  # "none", "knn" or "head": what a runner does unless told otherwise
    parity: Mapping[str, Any] = field(default_factory=dict)  # largest differences from PyTorch
    accuracy: Mapping[str, Any] = field(default_factory=dict)
    licence: str = "unknown"  # of the weights


@dataclass(frozen=True)
class Bundle:
    """A bundle whose files are all there and are what its manifest says."""

    path: Path
    manifest: Manifest

    def image_net(self, precision: str = "auto") -> Path:
        """The ONNX file of a precision: "float32", "int8", or "auto": float where the bundle has it.

        What suits the processor, `runtime.image.precision.choose_precision` says.
        """
        available = {"float32": IMAGE_NET, "int8": IMAGE_NET_INT8}
        available = {key: name for key, name in available.items() if name in self.manifest.files}
        wanted = precision if precision != "auto" else next(iter(available))
        if wanted not in available:
            raise BundleError(
                f"{self.path}: has no image network of precision {precision!r}, only {', '.join(available)}"
            )
        return self.path / available[wanted]

    def point_head(self) -> dict[str, NDArray[np.generic]]:
        """Weights of the point head, for `PointHeadEngine`. A kernel with a scale beside it is multiplied by that."""
        path = self.path / POINT_HEAD
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
                arrays = {key: stored[key] for key in stored.files}
            scales = {key.removesuffix(".scale"): arrays.pop(key) for key in list(arrays) if key.endswith(".scale")}
            for name, scale in scales.items():
                arrays[f"{name}.weight"] = arrays[f"{name}.weight"].astype(np.float32) * scale
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise BundleError(f"{path}: holds no weights of a point head ({error}); get the bundle again") from error
        return arrays


def load_bundle(path: str | Path | None = None) -> Bundle:
    """Read and verify a bundle; None: the default one.

    Raises BundleError for a bundle that is missing, incomplete, altered, or of a newer format; it names the file.
    """
    folder = default_bundle_path() if path is None else Path(path)
    if not folder.is_dir():
        raise BundleError(f"{folder}: there is no bundle here; give the folder that `mos export` wrote")
    manifest = parse_manifest(_read_json(folder / MANIFEST), str(folder / MANIFEST))
    for name in NETWORK_FILES:
        if name not in manifest.files and (folder / name).exists():
            raise BundleError(f"{folder / name}: is not in the manifest; remove it, or export the bundle again")
    if path is None and manifest.weights.get("trained") is not True:
        raise BundleError(f"{folder}: is the default bundle, but its weights are not trained; pass another one")
    for name, entry in manifest.files.items():
        _verify(folder / name, entry)
    return Bundle(folder, manifest)


def default_bundle_path() -> Path:
    """The bundle inside the installed package, or that of the checkout. Raises BundleError where there is none."""
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "default_bundle", here.parent / "models" / DEFAULT_BUNDLE):
        if (folder / MANIFEST).is_file():
            return folder
    raise BundleError(
        "no default bundle is installed: pass one, MosRunner('path/to/bundle') or --bundle path/to/bundle; "
        "`mos export --checkpoint X --out path/to/bundle` makes it from a checkpoint"
    )


def parse_manifest(values: Any, where: str) -> Manifest:
    """A manifest from what its JSON holds. Raises BundleError naming what is unknown, missing or wrong."""
    if not isinstance(values, dict) or type(values.get("format")) is not int:
        raise BundleError(f"{where}: is no manifest of a bundle (it has no format number)")
    if values["format"] != FORMAT:
        raise BundleError(
            f"{where}: is of format {values['format']}, this version of lidar-mos reads format {FORMAT}; "
            f"{'update lidar-mos' if values['format'] > FORMAT else 'export the checkpoint again'}"
        )
    parts = dict(values)
    for key, kind in (
        ("sensor", RangeImage),
        ("residual", Residual),
        ("point_head", PointHeadConfig),
        ("decision", Decision),
    ):
        if key in parts and (key != "point_head" or parts[key] is not None):
            parts[key] = _build(kind, parts[key], f"{where}: {key}")
    files = parts.get("files")
    if not isinstance(files, dict) or not {IMAGE_NET, IMAGE_NET_INT8} & set(files):
        raise BundleError(f"{where}: lists no image network under 'files'")
    parts["files"] = {name: _build(FileEntry, entry, f"{where}: files: {name}") for name, entry in files.items()}
    manifest = _build(Manifest, parts, where)
    if wrong := _contradictions(manifest):
        raise BundleError(f"{where}: {'; '.join(wrong)}")
    return manifest


def _contradictions(manifest: Manifest) -> list[str]:
    """What in a manifest cannot be, or does not fit together."""
    wrong = []
    for name, entry in manifest.files.items():
        if name not in NETWORK_FILES:
            wrong.append(f"file {name!r} is not one that a bundle holds")
        elif entry.precision not in NETWORK_FILES[name]:
            wrong.append(f"{name} has precision {entry.precision!r}, not {' or '.join(NETWORK_FILES[name])}")
    head = manifest.point_head
    if manifest.classes != CLASSES:
        wrong.append(f"classes are {manifest.classes}, this version knows {CLASSES}")
    if (head is not None) != (POINT_HEAD in manifest.files):
        wrong.append(f"'point_head' and the file {POINT_HEAD} must both be there, or neither")
    if head is None and POINT_HEAD_ONNX in manifest.files:
        wrong.append(f"{POINT_HEAD_ONNX} is there, but no 'point_head'")
    if head is not None and head.in_channels != manifest.features:
        wrong.append(f"the point head takes {head.in_channels} features, the image network gives {manifest.features}")
    if manifest.postprocess not in POSTPROCESSES or (manifest.postprocess == "head" and head is None):
        wrong.append(f"postprocess {manifest.postprocess!r} is unknown, or needs a point head that is not there")
    for threshold in (manifest.decision.threshold, manifest.decision.head_threshold):
        if threshold is not None and not (isinstance(threshold, (int, float)) and 0 <= threshold < 1):
            wrong.append(f"the threshold of moving must be a probability below 1, not {threshold!r}")
    return wrong


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _verify(path: Path, entry: FileEntry) -> None:
    try:
        if os.stat(path).st_size == entry.bytes and sha256_of(path) == entry.sha256:
            return
    except OSError as error:
        raise BundleError(f"{path}: cannot be read ({error.strerror}); get the bundle again") from error
    raise BundleError(f"{path}: is not the file that the manifest describes (altered or cut off); get the bundle again")


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BundleError(f"{path}: cannot be read ({error.strerror}); is this the folder of a bundle?") from error
    except ValueError as error:
        raise BundleError(f"{path}: is no JSON ({error}); get the bundle again") from error


def _build(kind: type[T], values: Any, where: str) -> T:
    if not isinstance(values, dict):
        raise BundleError(f"{where}: must be a mapping")
    if unknown := sorted(set(values) - {f.name for f in fields(kind)}):  # type: ignore[arg-type]
        raise BundleError(f"{where}: unknown entry {', '.join(unknown)} (a newer bundle? update lidar-mos)")
    try:
        return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in values.items()})
    except (TypeError, MosError) as error:
        raise BundleError(f"{where}: {error}") from error
