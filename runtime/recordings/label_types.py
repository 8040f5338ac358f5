"""What a label file holds that holds no labels: numbers of another type, or a mask that was never translated."""

import numpy as np
import numpy.typing as npt

from runtime.classes import LABELS, MOVING, OUTLIER

TYPES = {"<f4": "float32", "<f8": "float64", ">u4": "big-endian numbers"}
SIZES = {"<u8": "numbers of 64 bits", "<u2": "numbers of 16 bits", "u1": "numbers of 8 bits"}
LEAST = 1e-20  # a probability is zero or larger; the bits of a label, read as a float, are smaller
FEW = 64  # bytes: fewer say nothing of a size


def guess(data: bytes) -> str | None:
    """What `data` seems to be, whose numbers of four bytes are no labels; None: no idea."""
    most = _read(data, "<u4").max(initial=0)
    if most <= MOVING:
        return "a mask of zeros and ones" if most <= OUTLIER else "the classes of a network, 0 to 2"
    if _read(data, ">u4").max(initial=0) <= OUTLIER:
        return TYPES[">u4"]
    return other_size(data) or next((name for kind, name in TYPES.items() if _fits(_read(data, kind))), None)


def other_size(data: bytes) -> str | None:
    """The integers that `data` holds where labels of four bytes never look so: of a scan, some points are static."""
    if len(data) < FEW:
        return None
    if _read(data, "u1").max() == 1:
        return SIZES["u1"]
    for kind, name in SIZES.items():
        values = _read(data, kind)
        if len(values) and values.max() <= max(LABELS) and values.all() and np.isin(values, LABELS).all():
            return name
    return None


def _fits(values: npt.NDArray[np.number]) -> bool:
    """Whether all values are labels, with numbers of objects or without, a mask, or probabilities."""
    if values.dtype.kind == "f":
        if ((values == 0) | ((values > LEAST) & (values <= 1))).all():
            return len(values) > 0
        if not ((values >= 0) & (values < 1 << 32)).all() or (values != np.floor(values)).any():
            return False
    ids = values.astype(np.uint64) & 0xFFFF
    return bool(ids.any() and np.isin(ids, LABELS).all())


def _read(data: bytes, kind: str) -> npt.NDArray[np.number]:
    """Numbers of a type; none where `data` is no whole number of them."""
    return np.frombuffer(data if len(data) % np.dtype(kind).itemsize == 0 else b"", kind)
