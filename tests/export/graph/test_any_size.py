"""Graphs for images of any size: what PyTorch gives at each, and the integers of a graph that is made for one."""

import numpy as np
import pytest
import torch

from export.graph.any_size import Follows, any_size, named
from export.graph.image_graph import image_bytes
from export.int8.prepare import prepare
from runtime.compute.sessions import open_session
from tests.support.graphs import NAMES, SHAPE, image, network, run

OTHERS = [(1, 13, 16, 96), (1, 13, 48, 32)]


def test_numbers_that_follow_the_size_are_told_from_others():
    _, channels, height, width = any_size(13)
    assert Follows.of(channels) == Follows(0, 0, 13)
    assert Follows.of(0) == Follows(0, 0, 0)
    assert Follows.of(height // 8) == Follows(1, 0, 2)
    assert Follows.of(height * width // 2 * 24) == Follows(1, 1, 16 * 16 * 12)
    shape = (1, 24, height, width // 2, 3 * height * width, "points")
    assert named(shape) == (1, 24, "height", "width/2", "height*width*3", "points")


@pytest.mark.parametrize("name", ["rt", "v1", "lmnet"])
def test_images_of_every_size_give_what_pytorch_does(name):
    net = network(name, 16 if name == "rt" else 4)
    model = image_bytes(net.network, any_size(13))
    for shape in (SHAPE, *OTHERS):
        with torch.no_grad():
            want = net(torch.from_numpy(image(2, shape)))
        for a, b in zip(run(model, image(2, shape), NAMES), want, strict=True):
            np.testing.assert_allclose(a, b.numpy(), atol=1e-5)


@pytest.mark.parametrize("name", ["rt", "v1"])
def test_integers_are_those_of_a_graph_for_one_size(name):
    net, images = network(name, 16 if name == "rt" else 4), [image(), image(1)]
    one, every = prepare(net, SHAPE, images), prepare(net, any_size(13), images)
    assert one.ranges == every.ranges
    for a, b in zip(run(one.model(), image(3), NAMES), run(every.model(), image(3), NAMES), strict=True):
        np.testing.assert_array_equal(a, b)
    for shape in OTHERS:
        with torch.no_grad():
            want = net(torch.from_numpy(image(3, shape)))
        for a, b in zip(run(every.model(), image(3, shape), NAMES), want, strict=True):
            assert np.abs(a - b.numpy()).mean() < 2e-2 * np.abs(b.numpy()).max()


def test_a_session_for_one_size_gives_the_same_and_takes_no_other():
    model = image_bytes(network("rt", 16).network, any_size(13))
    session = open_session(model, threads=1, sizes={"height": 32, "width": 64})
    assert [value.shape for value in session.get_inputs() + session.get_outputs()][1] == [1, 3, 32, 64]
    for a, b in zip(session.run(NAMES, {"image": image()}), run(model, image(), NAMES), strict=True):
        np.testing.assert_array_equal(a, b)
    with pytest.raises(Exception, match="Expected: 32"):
        session.run(NAMES, {"image": image(0, OTHERS[0])})
