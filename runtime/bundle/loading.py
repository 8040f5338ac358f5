"""The bundle: a folder with an exported network and the manifest that says all there is to know about it."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from runtime.bundle.known_networks import check_network
from runtime.bundle.manifest import (
    CYLINDER_NET,
    IMAGE_NET,
    IMAGE_NET_INT8,
    MANIFEST,
    NETWORK_FILES,
    POINT_HEAD,
    FileEntry,
    Manifest,
    parse_manifest,
)
from runtime.errors import BundleError
from runtime.files import open_ordinary
from runtime.typed_json import read_json

DEFAULT_BUNDLE = "rt"
LARGEST_WEIGHTS = 1 << 28  # bytes of a file of weights, unpacked: more than all of the published ones


@dataclass(frozen=True)
class Bundle:
    """A bundle whose files are all there and are what its manifest says."""

    path: Path
    manifest: Manifest

    def image_net(self, precision: str = "auto") -> Path:
        """The network's file of a precision: "float32", "int8", or "auto": float where the bundle has it.

        What suits the processor, `runtime.image.precision.choose_precision` says.
        """
        known = (("float32", IMAGE_NET), ("float32", CYLINDER_NET), ("int8", IMAGE_NET_INT8))
        available = {key: name for key, name in known if name in self.manifest.files}
        wanted = precision if precision != "auto" else next(iter(available))
        if wanted not in available:
            raise BundleError(
                f"{self.path}: has no image network of precision {precision!r}, only {', '.join(available)}"
            )
        return self.path / available[wanted]

    def point_head(self) -> dict[str, NDArray[np.generic]]:
        """Weights of the point head, for `PointHeadEngine`."""
        return self._weights(POINT_HEAD, "a point head")

    def cylinder_net(self) -> dict[str, NDArray[np.generic]]:
        """Weights of a network that sees points in a cylinder, for `CylinderNet`."""
        return self._weights(CYLINDER_NET, "a network")

    def _weights(self, name: str, what: str) -> dict[str, NDArray[np.generic]]:
        """Arrays of a file. A kernel with a scale beside it is multiplied by that."""
        path = self.path / name
        try:
            with open_ordinary(path) as file, np.load(file, allow_pickle=False) as stored:
                if (size := sum(entry.file_size for entry in stored.zip.infolist())) > LARGEST_WEIGHTS:
                    raise ValueError(f"it unpacks to {size:,} bytes, {LARGEST_WEIGHTS:,} at most are known")
                arrays = {key: stored[key] for key in stored.files}
            scales = {key.removesuffix(".scale"): arrays.pop(key) for key in list(arrays) if key.endswith(".scale")}
            for name, scale in scales.items():
                arrays[f"{name}.weight"] = arrays[f"{name}.weight"].astype(np.float32) * scale
        except Exception as error:  # NumPy and Python raise almost anything over archives that are damaged
            raise BundleError(f"{path}: holds no weights of {what} ({error}); get the bundle again") from error
        return arrays


def load_bundle(path: str | Path | None = None) -> Bundle:
    """Read and verify a bundle; None: the default one.

    Raises BundleError for a bundle that is missing, incomplete, altered, or of a newer format; it names the file.
    """
    folder = default_bundle_path() if path is None else Path(path)
    if not folder.is_dir():
        raise BundleError(f"{folder}: there is no bundle here; give the folder that `mos export` wrote")
    manifest = parse_manifest(read_json(folder / MANIFEST, BundleError), str(folder / MANIFEST))
    for name in NETWORK_FILES:
        if name not in manifest.files and (folder / name).exists():
            raise BundleError(f"{folder / name}: is not in the manifest; remove it, or export the bundle again")
    if path is None and manifest.weights.get("trained") is not True:
        raise BundleError(f"{folder}: is the default bundle, but its weights are not trained; pass another one")
    for name, entry in manifest.files.items():
        _verify(folder / name, entry)
        if name.endswith(".onnx"):
            check_network(folder / name)
    return Bundle(folder, manifest)


def default_bundle_path() -> Path:
    """The bundle inside the installed package, or that of the checkout. Raises BundleError where there is none."""
    here = Path(__file__).resolve().parents[1]
    for folder in (here / "default_bundle", here.parent / "models" / DEFAULT_BUNDLE):
        if (folder / MANIFEST).is_file():
            return folder
    raise BundleError(
        "no default bundle is installed: name one (`bundle='path/to/bundle'`); "
        "`mos export --checkpoint X --out path/to/bundle` makes it from a checkpoint"
    )


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    with open_ordinary(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _verify(path: Path, entry: FileEntry) -> None:
    try:
        if os.stat(path).st_size == entry.bytes and sha256_of(path) == entry.sha256:
            return
    except OSError as error:
        raise BundleError(f"{path}: cannot be read ({error.strerror}); get the bundle again") from error
    raise BundleError(f"{path}: is not the file that the manifest describes (altered or cut off); get the bundle again")
