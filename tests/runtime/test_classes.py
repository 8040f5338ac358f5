"""Labels of SemanticKITTI as classes."""

import numpy as np

from runtime.classes import KINDS, LABELS, MOVERS, STATIC_LABELS, to_classes


def test_classes_come_from_the_lower_bits():
    raw = np.array([0, 1, 2, 9, 40, 99, 250, 251, 259, 260, 7 << 16, 7 << 16 | 252], np.uint32)
    np.testing.assert_array_equal(to_classes(raw), [0, 0, 1, 1, 1, 1, 1, 2, 2, 1, 0, 2])


def test_the_labels_are_those_of_semantickitti():
    static = {9, 10, 11, 13, 15, 16, 18, 20, 30, 31, 32, 40, 44, 48, 49, 50, 51, 52, 60, 70, 71, 72, 80, 81, 99}
    assert set(STATIC_LABELS) == static
    assert set(MOVERS) == set(range(251, 260))
    assert set(LABELS) == static | set(MOVERS) | {0, 1}
    assert len(LABELS) == len(set(LABELS))
    assert KINDS["car"] == (10, 252)
    assert KINDS["person"] == (30, 254)
