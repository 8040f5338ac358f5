"""The one way from JSON to a frozen dataclass: every key known, every value of the type that the field says."""

import json
import math
import types
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from runtime.errors import MosError, SettingError
from runtime.files import read_ordinary

T = TypeVar("T")

LONGEST = 16 << 20  # bytes of a file
DEEPEST = 32  # levels
DIGITS = 300  # of a whole number: float64 ends at 308


def build(kind: type[T], values: Any, where: str, error: type[MosError] = SettingError) -> T:
    """A dataclass `kind` from what JSON gave; lists become tuples, mappings within it dataclasses of their own.

    A missing key takes its default. Raises `error`, beginning with `where` and naming the entry: for an unknown or
    missing key, a value of another type (1.0 is no whole number, true no number), NaN, infinity, and for what `kind`
    itself refuses.
    """
    try:
        return _dataclass(kind, values, where)
    except MosError as refused:
        raise error(str(refused)) from refused


def read_json(path: Path, error: type[MosError]) -> Any:
    """What a JSON file holds.

    Raises `error` naming the file: it is not to be read, no JSON, larger or nested deeper than any that is meant, or
    holds NaN or a number beyond those of float64.
    """
    try:
        text = read_ordinary(path, LONGEST).decode("utf-8")
        found = json.loads(text, parse_constant=_refuse, parse_float=_finite, parse_int=_whole)
        _check_depth(found)
        return found
    except OSError as reason:
        raise error(f"{path}: cannot be read ({reason.strerror})") from reason
    except (ValueError, RecursionError) as reason:
        why = "it is nested too deeply" if isinstance(reason, RecursionError) else f"{reason}"
        raise error(f"{path}: is no JSON that can be read ({why:.200})") from reason


def _refuse(constant: str) -> Any:
    raise ValueError(f"it holds {constant}")


def _finite(text: str) -> float:
    if not math.isfinite(number := float(text)):
        _refuse(f"{text:.40}, no finite number")
    return number


def _whole(text: str) -> int:
    if len(text) > DIGITS:
        _refuse(f"a number of {len(text)} digits, which is not finite")
    return int(text)


def _check_depth(value: Any, left: int = DEEPEST) -> None:
    if not left:
        raise RecursionError
    if isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            _check_depth(item, left - 1)


def _dataclass(kind: type[T], values: Any, where: str) -> T:
    if not isinstance(values, Mapping):
        raise SettingError(f"{where}: must be a mapping, not {values!r:.60}")
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    if unknown := sorted(str(key) for key in values if key not in known):
        raise SettingError(
            f"{where}: unknown entry {', '.join(unknown)} (written by a newer version? update lidar-mos)"
        )
    needed = [name for name, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
    if missing := [name for name in needed if name not in values]:
        raise SettingError(f"{where}: has no {', '.join(missing)}")
    hints = get_type_hints(kind)
    made = {key: _value(hints[key], value, f"{where}: {key}") for key, value in values.items()}
    try:
        return kind(**made)
    except MosError as refused:
        raise SettingError(f"{where}: {refused}") from refused


def _value(hint: Any, value: Any, where: str) -> Any:
    """`value`, checked to be of the type `hint`."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in inner:
            return None
        (hint,) = (one for one in inner if one is not type(None))
        return _value(hint, value, where)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise SettingError(f"{where}: must be a list, not {value!r:.60}")
        return tuple(_value(inner[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            raise SettingError(f"{where}: must be a mapping, not {value!r:.60}")
        return {key: _value(inner[1], item, f"{where}: {key}") for key, item in value.items()}
    if is_dataclass(hint):
        return _dataclass(hint, value, where)  # type: ignore[arg-type]
    if hint is Any:
        return value
    return _plain(hint, value, where)


def _plain(hint: type, value: Any, where: str) -> Any:
    """A number, word or truth value."""
    if hint is float and type(value) in (int, float):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise SettingError(f"{where}: must be a finite number")
        return number
    if type(value) is not hint:
        names = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
        raise SettingError(f"{where}: must be {names.get(hint, hint.__name__)}, not {value!r:.60}")
    return value
