"""A terminal that breaks no line, and a small recording."""

import pytest

from tests.support import street


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Ten scans in KITTI's layout."""
    return street.write_kitti(tmp_path_factory.mktemp("kitti") / "sequences" / "07", 10, rows=16, columns=120)
