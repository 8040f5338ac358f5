import pytest

from tests.support.sweeps import Sweeps, drive


@pytest.fixture(scope="session")
def scans():
    """Of a drive, each all of one time, with their true poses."""
    sweeps = Sweeps(drive(5, 9, "off"))
    sweeps.times_of_points = False
    return list(sweeps)


@pytest.fixture(scope="session")
def raw():
    """The same as raw sweeps, whose stamps are those of their start."""
    return list(Sweeps(drive(5, 9, "on"), "start"))
