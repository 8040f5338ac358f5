"""PointCloud2, ROS's message of one scan: fields of any order, type, padding and byte order.

https://docs.ros.org/en/api/sensor_msgs/html/msg/PointCloud2.html
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from runtime.errors import ScanError
from runtime.recordings.cloud import Cloud, cloud_of

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of PointField


def to_cloud(message: Any, where: str) -> Cloud:
    """The points of a message row by row, those without a return too. Raises ScanError, beginning with `where`."""
    order = ">" if message.is_bigendian else "<"
    fields = {one.name: one for one in message.fields if one.count in (0, 1)}  # some drivers write 0 for 1
    if unknown := [name for name, one in fields.items() if one.datatype not in TYPES]:
        raise ScanError(f"{where}: its field {unknown[0]} is of an unknown type, {fields[unknown[0]].datatype}")
    record = np.dtype(
        {
            "names": list(fields),
            "formats": [order + TYPES[one.datatype] for one in fields.values()],
            "offsets": [one.offset for one in fields.values()],
        }
    )
    step, rows, width = message.point_step, message.height, message.width
    if rows * width and not record.itemsize <= step:
        raise ScanError(f"{where}: its fields take {record.itemsize} bytes, and a point has {step}")
    stride = message.row_step if rows > 1 else width * step
    data = np.asarray(message.data, np.uint8)
    if stride < width * step or len(data) < max(0, rows - 1) * stride + (width * step if rows else 0):
        raise ScanError(f"{where}: is cut off: {len(data)} bytes for {rows} rows of {width} points of {step} bytes")
    shape, strides = (rows, width), (stride, step)
    points = np.ndarray(shape, record, np.ascontiguousarray(data), 0, strides) if rows * width else np.empty(0, record)
    return cloud_of({name: points[name].reshape(-1) for name in fields}, where)


@dataclass(frozen=True)
class Head:
    """What stands before the points of a serialised message."""

    stamp: float  # s
    frame: str  # in which the points are
    count: int  # of points

    @classmethod
    def of(cls, data: bytes, ros1: bool) -> "Head":
        """Of a message as ROS 1 or, in CDR, ROS 2 serialises it. Raises ValueError where it is too short."""
        order = "<" if ros1 or data[1] & 1 else ">"
        seconds, nanoseconds, length = np.frombuffer(data, order + "u4", 3, 4)
        at = 16 + int(length)
        frame = bytes(data[16:at]).rstrip(b"\0").decode("utf-8", "replace")
        if not ros1:  # aligned to 4 bytes after the first 4, which say how it is encoded
            at += -at % 4
        height, width = np.frombuffer(data, order + "u4", 2, at)
        return cls(float(seconds) + 1e-9 * float(nanoseconds), frame, int(height) * int(width))
