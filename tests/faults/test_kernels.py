"""Arguments that do not fit: compiled code would read and write where nothing of it lies."""

import dataclasses

import numpy as np
import pytest

from runtime.belief.free_space import FreeSpace, Sight
from runtime.belief.memory import Memory
from runtime.belief.places import Surveyor
from runtime.bundle.manifest import BeliefNumbers
from runtime.cleaning.looks import Looks
from runtime.cleaning.voxel_votes import VoxelVotes
from runtime.compute.arena import Arena
from runtime.compute.workers import Workers
from runtime.errors import ScanError
from runtime.head.cylinder.cells import CellScale
from runtime.head.sparse.convolution import convolve, dense, pack, padded
from runtime.head.sparse.kernel_map import build_scales, neighbours, table_map
from runtime.head.transfer import FeatureMap, classify, exchange, features_to_voxels
from runtime.head.voxels import voxelise
from runtime.image.decision import point_results, take_refined
from runtime.image.vote import knn_vote
from runtime.sensors.range_image import RangeImage

WORKERS = Workers(1)
FAR = 1 << 30  # beyond everything that is there


def floats(*shape):
    return np.full(shape, 0.25, np.float32)


def pixels(*values):
    return np.array(values, np.int32)


VOTE = {
    "labels": np.ones((16, 32), np.uint8),
    "range_image": floats(16, 32),
    "pixel": pixels(0, 5, -1),
    "ranges": floats(3),
    "workers": WORKERS,
}
TAKE = {"probabilities": floats(3, 16, 32), "pixel": pixels(0, 5, -1), "threshold": 0.5}
REFINED = {"refined": floats(3, 3), "threshold": 0.5, "moving": np.zeros(3, np.bool_), "probability": floats(3)}
VOXELS = voxelise(np.arange(12, dtype=np.float32).reshape(4, 3), 0.5, WORKERS)
MAP = FeatureMap(floats(8, 16, 32), pixels(0, 5, 511, -1), 32)
TO_VOXELS = {"given": MAP, "voxels": VOXELS, "mean": False, "out": floats(4, 16), "workers": WORKERS}


def exchanged():
    scales = build_scales(VOXELS.keys, 1, Arena())
    return {
        "coarse": floats(len(scales[1].keys), 16),
        "table": neighbours(scales, 0, Arena(), WORKERS)[1],
        "members": np.append(scales[1].starts[:-1], 4).astype(np.int32),
        "keys": VOXELS.keys,
        "level": 1,
        "points": floats(4, 16),
        "out": floats(len(scales[1].keys), 16),
        "workers": WORKERS,
    }


def convolution():
    scales = build_scales(VOXELS.keys, 1, Arena())
    table = neighbours(scales, 0, Arena(), WORKERS)[0]
    return {
        "features": floats(4, padded(8)),
        "kernel_map": table_map(table, 4, Arena(), WORKERS, "map"),
        "weights": pack(floats(27, 8, 16), floats(16)),
        "out": floats(4, 16),
        "workers": WORKERS,
    }


def changed_map(**values):
    return {"kernel_map": dataclasses.replace(convolution()["kernel_map"], **values)}


KEYS = np.arange(5, dtype=np.int64)
PLACE = np.eye(4)


def bools(count):
    return np.ones(count, np.bool_)


def memory():
    return Memory(8, WORKERS, sets=16)


def votes():
    return VoxelVotes(0.1)


def sight(points=3):
    return Sight(floats(points, 4), PLACE, 0, floats(16, 32))


def free_space():
    found = FreeSpace(BeliefNumbers(), RangeImage(16, 32), WORKERS)
    for _ in range(20):
        found.add(found.sight(floats(3, 4), PLACE, floats(16, 32)))
    return found.weigh


LOOKS = {"points": floats(3, 3), "place": PLACE}
SURVEY = {"sight": sight(), "takes_part": bools(3), "probability": floats(3)}
WEIGH = {"sight": sight(), "log_odds": floats(3), "least": -9.0}
KEEP = {"keys": KEYS, "evidence": floats(5)}
VOTES = {"points": np.ones((3, 3)), "remission": floats(3), "moving": bools(3)}
SCALE = {"size": (2, 3, 4), "cells": pixels(0, 23), "rows": np.full(24, -1, np.int32)}


CASES = [
    (memory().add, KEEP, {"evidence": floats(4)}),
    (memory().add, KEEP, {"keys": np.arange(5, dtype=np.int32)}),
    (memory().recall, {"keys": KEYS}, {"keys": KEYS.astype(np.float64)}),
    (Surveyor(0.2, WORKERS).survey, SURVEY, {"takes_part": bools(2)}),
    (Surveyor(0.2, WORKERS).survey, SURVEY, {"probability": floats(2)}),
    (Surveyor(0.2, WORKERS).survey, SURVEY, {"sight": sight(4)}),
    (free_space(), WEIGH, {"log_odds": floats(FAR >> 20)}),
    (free_space(), WEIGH, {"sight": sight(2)}),
    (votes().add, VOTES, {"remission": floats(2)}),
    (votes().add, VOTES, {"moving": bools(2)}),
    (votes().add, VOTES, {"points": np.ones((3, 2))}),
    (votes().moves, {"points": np.ones((3, 3))}, {"points": np.ones((3, 2))}),
    (Looks(votes().moving()).add, LOOKS, {"points": floats(3, 2)}),
    (Looks(votes().moving()).add, LOOKS, {"place": np.eye(3)}),
    (CellScale, SCALE, {"rows": np.full(23, -1, np.int32)}),
    (CellScale, SCALE, {"cells": pixels(24)}),
    (CellScale, SCALE, {"cells": pixels(-1)}),
    (knn_vote, VOTE, {"pixel": pixels(0, FAR, -1)}),
    (knn_vote, VOTE, {"pixel": pixels(0, 512, -1)}),
    (knn_vote, VOTE, {"ranges": floats(2)}),
    (knn_vote, VOTE, {"range_image": floats(8, 32)}),
    (knn_vote, VOTE, {"labels": np.ones((16, 32))}),
    (point_results, TAKE, {"pixel": pixels(FAR)}),
    (point_results, TAKE, {"pixel": np.array([3.0])}),
    (point_results, TAKE, {"probabilities": floats(3, 1, 1)}),
    (point_results, TAKE, {"probabilities": floats(2, 16, 32)}),
    (take_refined, REFINED, {"moving": np.zeros(1, np.bool_)}),
    (take_refined, REFINED, {"refined": floats(3, 2)}),
    (features_to_voxels, TO_VOXELS, {"given": MAP._replace(pixel=pixels(0, 5, 512, -1))}),
    (features_to_voxels, TO_VOXELS, {"given": MAP._replace(pixel=pixels(0))}),
    (features_to_voxels, TO_VOXELS, {"given": MAP._replace(width=8)}),
    (features_to_voxels, TO_VOXELS, {"out": floats(2, 16)}),
    (features_to_voxels, TO_VOXELS, {"out": floats(4, 4)}),
    (exchange, exchanged(), {"table": np.zeros((2, 27), np.int32)}),
    (exchange, exchanged(), {"points": floats(1, 16)}),
    (exchange, exchanged(), {"out": floats(1, 8)}),
    (convolve, convolution(), {"features": floats(2, 16)}),
    (convolve, convolution(), {"out": floats(4, 32)}),
    (convolve, convolution(), {"out": floats(4)}),
    (convolve, convolution(), {"weights": pack(floats(8, 8, 16))}),
    (convolve, convolution(), {"shortcut": (floats(4, 16), pack(floats(16, 32)))}),
    (convolve, convolution(), changed_map(inputs=np.full_like(convolution()["kernel_map"].inputs, FAR))),
    (convolve, convolution(), changed_map(outputs=np.full_like(convolution()["kernel_map"].outputs, FAR))),
    (convolve, convolution(), changed_map(starts=np.full_like(convolution()["kernel_map"].starts, FAR))),
    (convolve, convolution(), changed_map(tile=1)),
    (convolve, convolution(), changed_map(tile=0)),
    (convolve, convolution(), changed_map(count_out=1 << 20)),
]


@pytest.mark.parametrize(("function", "arguments", "wrong"), CASES)
def test_what_does_not_fit_is_refused(function, arguments, wrong):
    function(**arguments)  # as they are, they do
    with pytest.raises(ScanError):
        function(**{**arguments, **wrong})


def test_dense_and_classify():
    with pytest.raises(ScanError):
        dense(floats(4, 16), pack(floats(16, 16)), floats(1 << 20, 16), WORKERS)
    with pytest.raises(ScanError):
        classify(floats(4, 8), floats(4, 8), floats(3, 16), floats(3), floats(4, 3), WORKERS)
    with pytest.raises(ScanError):
        classify(floats(1, 16), floats(4, 16), floats(3, 16), floats(3), floats(4, 3), WORKERS)


def test_weights_that_do_not_fit_themselves():
    with pytest.raises(ScanError):
        pack(floats(27, 8, 16), floats(3))
    with pytest.raises(ScanError):
        pack(floats(27, 8, 16), parts=(4, 8))
