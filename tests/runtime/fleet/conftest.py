"""Three little recordings, and their labels as one process writes them."""

import shutil

import pytest

from runtime.fleet.here import label_here
from runtime.fleet.wanted import Wanted
from runtime.fleet.work import settle
from runtime.recordings.recording import Options
from runtime.settings import RunnerSettings
from tests.support import street
from tests.support.paths import BUNDLE

NAMES, COUNT = ("01", "02", "03"), 40


@pytest.fixture(scope="session")
def drives(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives")
    for name, rows in zip(NAMES, (16, 24, 32), strict=True):
        street.write_kitti(folder / name, COUNT, rows=rows, columns=240)
    return folder


@pytest.fixture
def paths(drives):
    return [drives / name for name in NAMES]


@pytest.fixture
def work_at():
    """`work_at(out)`: label as `mos run --out OUT` does."""
    return lambda out: settle(BUNDLE, RunnerSettings(threads=1), Options(), out, False, Wanted())


@pytest.fixture(scope="session")
def plain(drives, tmp_path_factory):
    """The bytes of every label, by its path below the output, each recording labelled by itself."""
    out = tmp_path_factory.mktemp("plain")
    for name in NAMES:
        work = settle(BUNDLE, RunnerSettings(threads=1), Options(), out, False, Wanted())
        label_here(work, [drives / name], hear=lambda event: None)
    found = labels(out)
    assert len(found) == COUNT * len(NAMES)
    shutil.rmtree(out)
    return found


def labels(out):
    return {path.relative_to(out): path.read_bytes() for path in out.rglob("*.label")}
