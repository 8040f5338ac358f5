"""Which class is moving is said in one file."""

import ast

import numpy as np

from runtime import classes
from runtime.classes import KINDS, LABELS, MOVERS, STATIC_LABELS, to_classes
from tests.support.sources import PACKAGES, sources

PLACE = "runtime/classes.py"


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


def test_there_is_one_place():
    """No second name for a class or a set of labels, and no number of a moving label."""
    names = {name for name in vars(classes) if name.isupper() and not name.startswith("_")}
    assert {"CLASSES", "UNLABELLED", "STATIC", "MOVING"} <= names
    found = [
        f"{path}:{node.lineno}: {what}"
        for path, tree in sources(*PACKAGES, "tests")
        for node, what in (*_named(tree, names), *(_numbers(tree) if not path.startswith("tests/") else ()))
        if path != PLACE
    ]
    assert found == []


def _named(tree, names):
    """Assignments of numbers or of the classes' own names to one of `names`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            targets = {
                name.id
                for target in node.targets
                for name in getattr(target, "elts", [target])
                if isinstance(name, ast.Name)
            }
            values = {value.value for value in ast.walk(node.value) if isinstance(value, ast.Constant)}
            if targets & names and any(isinstance(value, int) or value in classes.CLASSES for value in values):
                yield node, f"defines {targets & names}"


def _numbers(tree):
    """Labels of movers (those that are no common number), a comparison of classes with a number."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) is int and node.value in MOVERS.keys() - {255, 256}:
            yield node, f"knows the label {node.value}"
        if isinstance(node, ast.Compare) and isinstance(node.comparators[0], ast.Constant):
            text = ast.unparse(node.left)
            if node.comparators[0].value in (0, 1, 2, 250, 260) and (
                "to_classes" in text or "0xFFFF" in text or "65535" in text or text.endswith(("classes", "labels"))
            ):
                yield node, f"compares {text} with a number"
