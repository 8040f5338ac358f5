"""PointCloud2 with other points or more fields; all other bytes of each point stay as they are."""

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from runtime.errors import ScanError

ADDED = {"probability": 7, "moving": 2}  # fields, and their types: float32, uint8
WORD = 4  # bytes, of a float32, and to a multiple of which points are padded


def without(cloud: Any, keep: npt.NDArray[np.bool_]) -> Any:
    """A PointCloud2 of only some of its points (N,): a row of them, were it organised."""
    if not cloud.height * cloud.width:
        return cloud
    points = _rows(cloud)[keep]
    count = len(points)
    return replace(cloud, height=1, width=count, row_step=count * cloud.point_step, data=points.reshape(-1))


def with_labels(
    cloud: Any, moving: npt.NDArray[np.bool_], probability: npt.NDArray[np.float32], where: str = "a cloud"
) -> Any:
    """A PointCloud2 whose points say too whether they move: `moving` (uint8, 0 or 1), `probability` (float32).

    moving, probability: (N,). Raises ScanError, beginning with `where`, if it has such fields already.
    """
    if taken := [one.name for one in cloud.fields if one.name in ADDED]:
        raise ScanError(f"{where}: has a field {taken[0]} already; give the recording without labels")
    at = -(-cloud.point_step // WORD) * WORD
    offsets = (at, at + WORD)
    points = np.zeros((cloud.height * cloud.width, at + 2 * WORD), np.uint8)
    if len(points):
        points[:, : cloud.point_step] = _rows(cloud)
    order = ">f4" if cloud.is_bigendian else "<f4"
    points[:, at : at + WORD] = np.ascontiguousarray(probability, order).view(np.uint8).reshape(-1, WORD)
    points[:, at + WORD] = moving
    make = type(cloud.fields[0])
    fields = [make(name, offset, kind, 1) for (name, kind), offset in zip(ADDED.items(), offsets, strict=True)]
    step = points.shape[1]
    return replace(
        cloud,
        fields=[*cloud.fields, *fields],
        point_step=step,
        row_step=step * cloud.width,
        data=points.reshape(-1),
    )


def _rows(cloud: Any) -> npt.NDArray[np.uint8]:
    """(N, point_step) the bytes of each point of a cloud that has some."""
    size, rows, width = cloud.point_step, cloud.height, cloud.width
    stride = cloud.row_step if rows > 1 else width * size
    data = np.ascontiguousarray(cloud.data, np.uint8)
    return np.ndarray((rows, width, size), np.uint8, data, 0, (stride, size, 1)).reshape(-1, size)
