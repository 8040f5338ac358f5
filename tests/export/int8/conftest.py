"""A small network that is ready for integers."""

import pytest

from export.int8.prepare import prepare
from tests.support.graphs import SHAPE, image, network


@pytest.fixture(scope="package")
def prepared():
    return prepare(network(), SHAPE, [image()])
