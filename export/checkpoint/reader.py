"""Reads the tensors of a checkpoint file without running anything of it.

`torch.load(weights_only=True)` reads files of tensors and plain values, but refuses those with optimizers,
schedulers, NumPy values or parsed arguments inside, which training scripts often write. For these there is
a reader in two steps. First the pickle is read with an `Inert` class in place of every class and function
that it names: no name of the file is ever looked up. Then the records of tensors among the inert objects
are checked and built.
"""

import os
import pickle
import sys
import zipfile
from collections.abc import Callable, Iterable
from math import prod
from pathlib import Path
from typing import IO, Any, BinaryIO

import torch
from torch import Tensor

from runtime.errors import CheckpointError

ADVICE = "pass a file that torch.save wrote; if it is one, it may be cut short: fetch or copy it again"

_LEGACY_MAGIC = 0x1950A86A20F9469CFC6C  # first number of what torch.save wrote before its files were zip archives
_DTYPES = {
    "DoubleStorage": torch.float64,
    "FloatStorage": torch.float32,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}
_MAPPINGS = ("collections.OrderedDict", "collections.defaultdict")
_TENSORS = ("torch._utils._rebuild_tensor_v2", "torch._utils._rebuild_tensor")
_PARAMETERS = ("torch._utils._rebuild_parameter", "torch._utils._rebuild_parameter_with_state")


def read_tensors(path: str | os.PathLike[str]) -> dict[Any, Any]:
    """The mapping that a checkpoint holds: dicts, lists and tuples of tensors (on the CPU) and plain values.

    An object of any other class is an `Inert` that stands in for it. Raises CheckpointError where the file is
    missing, no checkpoint, cut short, or not a mapping.
    """
    if not Path(path).is_file():
        found = "this is a folder" if Path(path).is_dir() else "there is no such file"
        raise CheckpointError(f"{path}: is no checkpoint ({found}): {ADVICE}")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError:
        content = _read_restricted(path)
    except Exception as error:  # broken bytes make it raise almost any type
        raise _no_checkpoint(path, error) from error
    if not isinstance(content, dict):
        what = content.name if isinstance(content, Inert) else type(content).__name__
        raise CheckpointError(
            f"{path}: holds a {what} instead of a mapping of tensors: "
            "save it again with torch.save(network.state_dict(), path)"
        )
    return content


class Inert:
    """Stands in for an object of the file. Remembers how it was made and filled, and does nothing."""

    __slots__ = ("arguments", "entries")
    name = "object"  # what the file calls it: "module.class"
    arguments: tuple[Any, ...]
    entries: dict[Any, Any]

    def __new__(cls, *arguments: Any, **_: Any) -> "Inert":
        self = object.__new__(cls)
        self.arguments = arguments
        self.entries = {}
        return self

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __setitem__(self, key: Any, value: Any) -> None:
        self.entries[key] = value

    def __setstate__(self, state: Any) -> None: ...

    def append(self, item: Any) -> None: ...

    def extend(self, items: Any) -> None: ...

    def add(self, item: Any) -> None: ...

    def __repr__(self) -> str:
        return f"<{self.name}>"


class _Storage(Inert):
    """A persistent id of the file: ("storage", type, key, location, count[, view])."""

    __slots__ = ()
    name = "storage"


class _Unpickler(pickle.Unpickler):
    """Makes plain values and `Inert` objects only."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(file, encoding="utf-8")
        self.storages: list[_Storage] = []

    def find_class(self, module: str, name: str) -> type[Inert]:
        return type("Inert", (Inert,), {"__slots__": (), "name": f"{module}.{name}"})

    def persistent_load(self, pid: Any) -> _Storage:
        self.storages.append(_Storage(*pid))
        return self.storages[-1]


def _read_restricted(path: str | os.PathLike[str]) -> Any:
    try:
        with open(path, "rb") as file:
            return _read_zip(file) if zipfile.is_zipfile(file) else _read_legacy(file)
    except Exception as error:  # whatever the bytes of a broken or hostile file make it raise
        raise _no_checkpoint(path, error) from error


def _no_checkpoint(path: str | os.PathLike[str], error: Exception) -> CheckpointError:
    reason = str(error).split("\n", 1)[0] or type(error).__name__
    return CheckpointError(f"{path}: is no checkpoint that can be read safely ({reason}): {ADVICE}")


def _read_zip(file: BinaryIO) -> Any:
    """An archive of NAME/data.pkl and one NAME/data/KEY for each storage, none of them compressed."""
    with zipfile.ZipFile(file) as archive:
        pickles = [name for name in archive.namelist() if name.count("/") == 1 and name.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise ValueError("a zip archive, but not one of torch.save")
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
            raise ValueError("a compressed archive, which torch.save never writes")
        folder = pickles[0].removesuffix("data.pkl")
        if f"{folder}byteorder" in archive.namelist():
            _check_byte_order(archive.read(f"{folder}byteorder").decode())
        with archive.open(pickles[0]) as data:
            tree = _Unpickler(data).load()
        return _Builder(lambda key: bytearray(archive.read(f"{folder}data/{key}"))).build(tree)


def _read_legacy(file: BinaryIO) -> Any:
    """Pickles of magic number, version, machine, content, keys; then count (int64) and bytes of storages."""
    file.seek(0)
    if _Unpickler(file).load() != _LEGACY_MAGIC:
        raise ValueError("not written by torch.save")
    _Unpickler(file).load()
    _check_byte_order("little" if _Unpickler(file).load()["little_endian"] else "big")
    unpickler = _Unpickler(file)
    tree = unpickler.load()
    sizes = {key: dtype.itemsize for key, dtype, _ in map(_described, unpickler.storages)}
    data: dict[str, bytearray] = {}
    remaining = os.fstat(file.fileno()).st_size
    for key in _Unpickler(file).load():
        count = int.from_bytes(file.read(8), "little")
        if count * sizes[key] > remaining - file.tell():
            raise ValueError(f"storage {key} is cut short")
        data[key] = bytearray(file.read(count * sizes[key]))
    return _Builder(data.__getitem__).build(tree)


def _check_byte_order(order: str) -> None:
    if order != sys.byteorder:
        raise ValueError(f"written on a {order}-endian machine: save it again on one like this")


def _described(storage: Any) -> tuple[str, torch.dtype, int]:
    """Key, dtype and number of elements of a storage; a view into another one (legacy files) is refused."""
    if not isinstance(storage, _Storage):
        raise ValueError("a tensor without storage")
    kind, type_, key, _, count, *view = storage.arguments
    if kind != "storage" or not isinstance(key, str) or type(count) is not int or any(view):
        raise ValueError(f"unknown kind of storage {key!r}")
    module, _, name = _name(type_).rpartition(".")
    if module not in ("torch", "torch.cuda") or name not in _DTYPES:
        raise ValueError(f"storage {key!r} has the unknown type {module}.{name}")
    return key, _DTYPES[name], count


def _name(value: Any) -> str:
    return value.name if isinstance(value, type) and issubclass(value, Inert) else repr(value)


class _Builder:
    """Turns what `_Unpickler` made into plain containers of tensors."""

    def __init__(self, read: Callable[[str], bytearray]) -> None:
        self.read = read  # bytes of a storage
        self.storages: dict[str, Tensor] = {}
        self.built: dict[int, Any] = {}  # what each object of the tree became: it may be used twice, or hold itself

    def build(self, value: Any) -> Any:
        if not isinstance(value, dict | list | tuple | Inert):
            return value
        if id(value) not in self.built:
            self.built[id(value)] = self.convert(value)
        return self.built[id(value)]

    def convert(self, value: Any) -> Any:
        if isinstance(value, Inert):
            if value.name in _TENSORS:
                return self.tensor(*value.arguments)
            if value.name in _PARAMETERS:
                return self.build(value.arguments[0])
            if value.name not in _MAPPINGS:
                return value
            return self.fill(value, value.entries)
        if isinstance(value, dict):
            return self.fill(value, value)
        if isinstance(value, tuple):
            return tuple(self.build(item) for item in value)
        items: list[Any] = []
        self.built[id(value)] = items
        items.extend(self.build(item) for item in value)
        return items

    def fill(self, origin: Any, entries: dict[Any, Any]) -> dict[Any, Any]:
        items: dict[Any, Any] = {}
        self.built[id(origin)] = items
        items.update((key, self.build(item)) for key, item in entries.items())
        return items

    def tensor(self, storage: Any, offset: Any, size: Any, stride: Any, *_: Any) -> Tensor:
        """A view of its storage; refused where it would reach past it or hold elements twice."""
        key, dtype, count = _described(storage)
        if not (_is_counts((offset,)) and _is_counts(size) and _is_counts(stride) and len(size) == len(stride)):
            raise ValueError(f"a tensor of storage {key} has no proper shape")
        steps = sum((n - 1) * step for n, step in zip(size, stride, strict=True))
        if prod(size) and (offset + steps >= count or prod(size) > count):
            raise ValueError(f"a tensor of storage {key} reaches past its end")
        if not prod(size):
            return torch.empty(size, dtype=dtype)
        return torch.as_strided(self.storage(key, dtype, count), size, stride, offset)

    def storage(self, key: str, dtype: torch.dtype, count: int) -> Tensor:
        """All elements of a storage (count,)."""
        if key not in self.storages:
            data = self.read(key)
            if len(data) % dtype.itemsize:
                raise ValueError(f"storage {key} is cut short")
            self.storages[key] = torch.frombuffer(data, dtype=dtype)
        if self.storages[key].dtype != dtype or len(self.storages[key]) != count:
            raise ValueError(f"storage {key} is not of the size that the file says")
        return self.storages[key]


def _is_counts(values: Iterable[Any]) -> bool:
    return isinstance(values, tuple) and all(type(value) is int and 0 <= value < 2**48 for value in values)
