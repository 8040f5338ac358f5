"""Writing a bundle: whole or not at all, and the same bytes for the same content."""

import contextlib
import dataclasses
import json
import math
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from runtime.bundle.loading import sha256_of
from runtime.bundle.manifest import FORMAT, MANIFEST, NETWORK_FILES, FileEntry, Manifest
from runtime.errors import BundleError, CheckpointError
from runtime.files import replacing_folder

MOST_VALUES, DEEPEST = 100_000, 16  # of a training record


@contextlib.contextmanager
def replacing_bundle(target: Path) -> Iterator[Path]:
    """A folder to write a bundle into; it becomes `target` when the block ends, and vanishes if the block raises.

    Of a bundle that is at `target` already, the files that are not part of it (model card, checkpoint) are kept. Raises
    BundleError where something else is there, OutputError where the disk refuses.
    """
    if target.exists() and not (target / MANIFEST).is_file() and not (target.is_dir() and _only_extras(target)):
        raise BundleError(f"{target}: is there already and is no bundle; choose another folder (`out`)")
    with replacing_folder(target) as folder:
        yield folder
        _keep_extras(target, folder)


def _only_extras(folder: Path) -> bool:
    """Whether a folder holds at most what goes beside a bundle."""
    return {item.name for item in folder.iterdir()} <= {"checkpoint.pt", "README.md"}


def _keep_extras(old: Path, new: Path) -> None:
    if old.is_dir():
        for item in sorted(old.iterdir()):
            if item.name == MANIFEST or item.name in NETWORK_FILES:
                continue
            if item.is_dir():
                shutil.copytree(item, new / item.name)
            else:
                shutil.copy2(item, new / item.name)


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write `manifest.json`."""
    values = {"format": FORMAT} | dataclasses.asdict(manifest)
    text = json.dumps(values, indent=1, allow_nan=False) + "\n"
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def file_entry(path: Path, precision: str) -> FileEntry:
    """What the manifest says of a file."""
    return FileEntry(sha256_of(path), path.stat().st_size, precision)


def rounded_to_half(module: nn.Module, what: str) -> None:
    """Round every kernel and matrix of `module` to what float16 holds, in place; vectors stay as they are.

    Raises CheckpointError where a weight is beyond the range of float16.
    """
    state: Mapping[str, Tensor] = module.state_dict()
    lost = []
    for key, value in state.items():
        if value.ndim > 1 and value.is_floating_point():
            half = value.half()
            if not bool(half.isfinite().all()):
                lost.append(key)
            value.copy_(half.float())
    if lost:
        raise CheckpointError(f"{what}: too large for float16: {', '.join(lost)}; keep float32 (`weights='float32'`)")


def plain(values: Any) -> Any:
    """JSON values of a training record; tensors, infinity and the like are left out.

    Raises CheckpointError where it is longer, or nested deeper, than any record: a few bytes of a file can stand for
    lists of lists without end.
    """
    left = MOST_VALUES

    def of(value: Any, levels: int) -> Any:
        nonlocal left
        left -= 1
        if left < 0 or levels < 0:
            raise CheckpointError(
                f"the record of the training has more than {MOST_VALUES:,} values, or {DEEPEST} levels: it is none"
            )
        if isinstance(value, Mapping):
            return {str(key): of(item, levels - 1) for key, item in value.items() if _is_plain(item)}
        if isinstance(value, (list, tuple)):
            return [of(item, levels - 1) for item in value if _is_plain(item)]
        return value

    return of(values, DEEPEST)


def _is_plain(value: Any) -> bool:
    if isinstance(value, float) and not math.isfinite(value):  # the best score of a run without validation
        return False
    return value is None or isinstance(value, (bool, int, float, str, Mapping, list, tuple))
