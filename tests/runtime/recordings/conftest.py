"""A root with two KITTI sequences of tiny scans, and files of other projects."""

import shutil

import pytest

from tests.support import street
from tests.support.paths import SHARED


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A root with the KITTI sequences 03 and 11, of six tiny scans each."""
    root = tmp_path_factory.mktemp("kitti")
    for name in ("03", "11"):
        street.write_kitti(root / "sequences" / name, 6, rows=4, columns=20)
    return root


@pytest.fixture
def root(made, tmp_path):
    return shutil.copytree(made, tmp_path / "root")


@pytest.fixture
def folder(root):
    return root / "sequences" / "03"


@pytest.fixture
def readers():
    """The folder of files that public projects keep to test their own readers."""
    folder = SHARED / "data" / "readers"
    if not folder.is_dir():
        pytest.skip(f"real files are not at {folder}")
    return folder
