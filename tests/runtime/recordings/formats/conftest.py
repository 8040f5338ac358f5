"""Scans that are hard to write."""

import numpy as np
import pytest


@pytest.fixture
def scan():
    """(200, 4) float32, of awkward numbers; the first point is NaN."""
    rng = np.random.default_rng(5)
    made = np.hstack([rng.normal(0, 20, (200, 3)), rng.random((200, 1))]).astype(np.float32)
    made[0] = np.nan
    made[1, 0], made[2, 1] = 1e-30, -123456.7
    return made
