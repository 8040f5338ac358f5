"""A file with two kernels, loaded as a process would that has just started."""

import importlib.util

import pytest

SOURCE = """
from runtime.compute.jit import kernel

@kernel
def half(x):
    return x / 2

@kernel
def thrice(x):
    return 3 * x
"""


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "kernels_of_a_test.py"
    path.write_text(SOURCE)
    return path


@pytest.fixture
def load(source):
    def new():
        spec = importlib.util.spec_from_file_location(source.stem, source)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return new
