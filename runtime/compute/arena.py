"""Workspaces that are reused from scan to scan."""

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

ALIGNMENT = 64  # bytes, one cache line: no vector load straddles two


def aligned_empty(shape: Sequence[int], dtype: DTypeLike) -> NDArray[Any]:
    """`np.empty` whose first element starts a cache line."""
    size = prod(shape) * np.dtype(dtype).itemsize
    raw = np.empty(size + ALIGNMENT, np.uint8)
    skip = -raw.ctypes.data % ALIGNMENT
    return raw[skip : skip + size].view(dtype).reshape(shape)


SPARE = 1 << 28  # bytes that are kept whatever happens
WINDOW = 32  # scans
MUCH = 4  # times what they needed


class Arena:
    """Named buffers, kept between scans: each grows to the largest scan seen and an eighth.

    Where they are large together, those that are far larger than the last scans needed are given back: one scan of
    millions of points does not keep its memory for good.
    """

    def __init__(self) -> None:
        self._buffers: dict[str, NDArray[np.uint8]] = {}
        self._needed: dict[str, int] = {}  # bytes, at most, since the last look
        self._scans = 0

    def next_scan(self) -> None:
        """Nothing that was taken before is in use any more."""
        self._scans += 1
        if self._scans % WINDOW == 0:
            if self.nbytes > SPARE:
                needed = self._needed
                self._buffers = {
                    name: one for name, one in self._buffers.items() if one.nbytes <= MUCH * needed.get(name, 0)
                }
            self._needed = {}

    def take(self, name: str, shape: Sequence[int], dtype: DTypeLike = np.float32) -> NDArray[Any]:
        """The buffer `name` as an array of this shape; its content is what was left there."""
        size = prod(shape) * np.dtype(dtype).itemsize
        self._needed[name] = max(size, self._needed.get(name, 0))
        if name not in self._buffers or self._buffers[name].nbytes < size:
            self._buffers.pop(name, None)  # free the old one first
            self._buffers[name] = aligned_empty((size + size // 8,), np.uint8)
        return self._buffers[name][:size].view(dtype).reshape(shape)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(buffer.nbytes for buffer in self._buffers.values())
