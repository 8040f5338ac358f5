"""Arguments of functions whose kernels trust them: compiled code reads wherever it is told to."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from runtime.errors import ScanError


def need(array: NDArray[Any], name: str, shape: tuple[int | None, ...], dtype: DTypeLike) -> None:
    """Raise ScanError unless an array has this shape (None: any number) and dtype."""
    fits = isinstance(array, np.ndarray) and array.dtype == dtype and array.ndim == len(shape)
    if not fits or any(want not in (None, has) for want, has in zip(shape, array.shape, strict=True)):
        given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise ScanError(f"{name} must be an array ({wanted}) of {np.dtype(dtype)}, not {given}")


def need_below(array: NDArray[np.integer], limit: int, name: str, lowest: int | None = None) -> None:
    """Raise ScanError unless all whole numbers of an array are below `limit`; lowest: and not below this."""
    if array.size and (array.max() >= limit or (lowest is not None and array.min() < lowest)):
        least = "" if lowest is None else f" and at least {lowest}"
        raise ScanError(f"{name} must be below {limit}{least}, not {array.min()} to {array.max()}")
