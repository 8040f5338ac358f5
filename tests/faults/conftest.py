"""What tests of faults share."""

import shutil
from pathlib import Path

import pytest

from tests.support.paths import BUNDLE


@pytest.fixture
def bundle(tmp_path) -> Path:
    """A copy of the tiny bundle, to be spoilt."""
    return Path(shutil.copytree(BUNDLE, tmp_path / "bundle"))
