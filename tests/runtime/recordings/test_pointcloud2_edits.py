"""Clouds with other points or more fields, against NumPy's own records."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from runtime.errors import ScanError
from runtime.recordings.pointcloud2_edits import with_labels, without

TYPES = {2: "u1", 4: "u2", 7: "f4"}


@dataclass
class Field:
    name: str
    offset: int
    datatype: int
    count: int


@dataclass
class Message:
    height: int
    width: int
    point_step: int
    row_step: int
    data: np.ndarray
    is_bigendian: bool
    fields: list = field(default_factory=lambda: [Field("x", 0, 7, 1), Field("ring", 4, 4, 1)])


def message(rows, width, step=7, padding=3, order="<"):
    record = np.dtype(
        {"names": ["x", "ring"], "formats": [order + "f4", order + "u2"], "offsets": [0, 4], "itemsize": step}
    )
    points = np.zeros(rows * width, record)
    points["x"], points["ring"] = np.arange(rows * width) / 2, np.arange(rows * width)
    data = points.view(np.uint8).reshape(rows, width * step)
    data = np.pad(data, ((0, 0), (0, padding if rows > 1 else 0)))
    return Message(rows, width, step, data.shape[1], data.reshape(-1), order == ">")


def columns(message):
    order = ">" if message.is_bigendian else "<"
    shown = {one.name: (order + TYPES[one.datatype], one.offset) for one in message.fields}
    record = np.dtype(
        {
            "names": list(shown),
            "formats": [kind for kind, _ in shown.values()],
            "offsets": [offset for _, offset in shown.values()],
            "itemsize": message.point_step,
        }
    )
    assert message.row_step == message.width * message.point_step
    points = np.frombuffer(message.data.tobytes(), record)
    assert len(points) == message.height * message.width
    return points


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("rows", "width"), [(1, 6), (2, 3), (1, 1), (1, 0), (0, 0)])
def test_labels_are_two_more_fields(rows, width, order):
    given, count = message(rows, width, order=order), rows * width
    moving, probability = np.arange(count) % 2 == 0, np.linspace(0, 1, count, dtype=np.float32)
    before = given.data.copy()
    labelled = with_labels(given, moving, probability)
    found = columns(labelled)
    np.testing.assert_array_equal(found["x"], np.arange(count) / 2)
    np.testing.assert_array_equal(found["ring"], np.arange(count))
    np.testing.assert_array_equal(found["moving"], moving)
    np.testing.assert_array_equal(found["probability"], probability)
    assert (labelled.height, labelled.width) == (rows, width)
    assert labelled.point_step % 4 == 0
    assert all(one.offset % 4 == 0 for one in labelled.fields if one.datatype == 7)
    np.testing.assert_array_equal(given.data, before)
    kept = columns(without(labelled, ~moving)) if count else labelled
    np.testing.assert_array_equal(kept["ring"] if count else [], np.arange(count)[1::2])


def test_a_cloud_that_is_labelled_already():
    labelled = with_labels(message(1, 2), np.zeros(2, bool), np.zeros(2, np.float32))
    with pytest.raises(ScanError, match="/points: has a field probability already"):
        with_labels(labelled, np.zeros(2, bool), np.zeros(2, np.float32), "/points")
