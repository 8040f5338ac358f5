"""Each question has one answer, in one place: a search for the spellings of a second one.

`Place` names where the answer is; `others` are files that ask something else in the same words, with what they ask.
"""

import ast
import re
from dataclasses import dataclass, field, fields

import pytest

from runtime import classes
from runtime.bundle.manifest import Tuned
from runtime.classes import MOVERS
from runtime.sensors.registry import SENSORS
from tests.support.sources import PACKAGES, code, sources


@dataclass(frozen=True)
class Place:
    """Where a question is answered, and what a second answer looks like in code without comments and docstrings."""

    answer: str
    spellings: tuple[str, ...]
    others: dict[str, str] = field(default_factory=dict)


PLACES = {
    "which points take part": Place(
        "runtime/image/entry.py",
        (
            r"isfinite\(.*\)\.all\((axis=)?-?1\)",  # all coordinates of a point
            r"isfinite\(\w+\[\w+, \w+\]\)",  # one, within a kernel
            r"\.any\((axis=)?-?1\)",  # not at the origin
            r"== ?0\)\.all\((axis=)?-?1\)",
            r"!= ?0\)\.any\((axis=)?-?1\)",
            r"isfinite\(\w+\) ?[&,] ?(\(?\w+ )[=>]=? ?0\b",  # ranges
        ),
        {
            "runtime/doctor/": "what share of them does not, and why; which things of two scans are compared",
            "runtime/pictures/": "what can be drawn",
            "bench/peers.py": "what another tool takes",
            "export/graph/rewrite.py": "which channels of a kernel are not all zero",
        },
    ),
    "how far returns reach": Place(
        "runtime/sensors/",
        (r"[=<>] ?300\.0\b", r"UNKNOWN_REACH"),
        {
            "runtime/bundle/manifest.py": "of a manifest that does not say: the same number",
            "runtime/image/inputs.py": "of a builder that is told nothing: the same number",
            "runtime/doctor/": "what to say of ranges",
        },
    ),
    "what stands in for missing remission": Place(
        "runtime/image/entry.py",
        (r"0\.21\b", r"remission_fill|fill_remission", r"mean\[4\]"),
        {
            "runtime/sensors/range_image.py": "what the networks subtract",
            "runtime/image/inputs.py": "hands that to the entry",
            "mos_model/data/dataset.py": "hands that to the entry",
        },
    ),
    "where was the past scan": Place(
        "runtime/recordings/poses.py",
        (r"linalg\.(inv|solve)\(", r"\[:3, :3\]\.T @", r"\[\.\.\., :3, :3\]\.swapaxes"),
        {
            "runtime/recordings/": "what the poses of a file are poses of",
            "runtime/doctor/": "what they would be if they were meant otherwise",
            "mos_model/simulator/write.py": "poses of KITTI's camera",
            "bench/corruption.py": "poses that are wrong on purpose",
            "bench/formats.py": "poses of a vehicle that carries the LiDAR",
        },
    ),
    "how a scan is read": Place(
        "runtime/recordings/",
        (
            r"np\.fromfile",
            r"read_cloud\(|read_pose_table\(|read_calib\(",
            r"[\"']velodyne[\"']",
            r"[\"'](poses|calib|times)\.txt[\"']",
            r"[\"']\.(bin|npy|pcd|las|laz|feather)[\"']",
        ),
        {
            "mos_model/simulator/write.py": "how simulated drives are written",
            "runtime/compute/packages.py": "an extra of that name",
            "bench/formats.py": "whether all formats are read alike",
            "bench/damaged": "what readers say of damaged files",
            "bench/faults.py": "which of them are damaged",
            "runtime/odometry/pose_store.py": "how poses that were found are kept",
        },
    ),
    "which sensor is simulated": Place(
        "runtime/sensors/",
        (rf"[\"']({'|'.join(SENSORS)})[\"']", r"\bsimulate\(\w+, [^,)]+\)"),
        {
            "bench/sensors.py": "places and sensors that go together: a small room, fog",
            "bench/watching.py": "streets of several sensors, of which nothing is to be said",
        },
    ),
    "how a dataclass is read from JSON": Place(
        "runtime/typed_json.py",
        (r"json\.loads?\(", r"get_type_hints\(", r"\bfields\(cls\)", r"def from_(dict|json)\("),
        {
            "runtime/recordings/journal.py": "one line after the other; what it holds is built there",
            "runtime/recordings/run_note.py": "what is about to be written, as it will be read: lists for tuples",
            "mos_model/train.py": "a single value of the command line",
            "bench/startup.py": "what its own process printed",
            "bench/faults.py": "what its own process printed",
            "bench/damaged.py": "manifests that are damaged",
            "bench/mutations.py": "so is JSON of any kind",
        },
    ),
    "where a tuned number lives": Place(
        "runtime/bundle/manifest.py",
        (
            r"^\s*_?(CANDIDATE|HALO|MISFIT|JUMP)\w* *(:[^=]+)?= *[0-9.]",
            rf"\bTuned\.({'|'.join(one.name for one in fields(Tuned))})\b",
        ),
        {
            "runtime/head/refinement.py": "the default of a head without a bundle",
            "mos_model/tuning/thresholds.py": "the default of what is calibrated",
        },
    ),
}


@pytest.mark.parametrize(("question", "spelling"), [(name, s) for name, one in PLACES.items() for s in one.spellings])
def test_nobody_answers_again(question, spelling):
    place = PLACES[question]
    found = [
        f"{path}:{number}: {line.strip()}"
        for path, _ in sources()
        if not path.startswith((place.answer, *place.others))
        for number, line in code(path)
        if re.search(spelling, line)
    ]
    assert found == [], f"{question}: {place.answer} answers this"


@pytest.mark.parametrize("question", PLACES)
def test_who_is_excused_is_there_and_asks(question):
    """Else an excuse would outlive its reason."""
    place = PLACES[question]
    assert any(path.startswith(place.answer) for path, _ in sources())
    for other in place.others:
        lines = [line for path, _ in sources() if path.startswith(other) for _, line in code(path)]
        assert any(re.search(spelling, line) for spelling in place.spellings for line in lines), other


# How a file is replaced: runtime/files.py

MOVES = {"os.replace", "os.rename", "os.renames", "os.link", "shutil.move", "tempfile.mkstemp", "tempfile.mkdtemp"}


def test_a_file_is_replaced_in_one_place():
    """Nothing else moves a file into the place of another, or has temporary names of its own."""
    assert calls_elsewhere("runtime/files.py", is_move) == []


def is_move(call):
    """Moves of the standard library, and `.rename(target)` or `.replace(target)`, as only paths have them."""
    if ast.unparse(call.func) in MOVES:
        return True
    if isinstance(call.func, ast.Attribute) and call.func.attr in ("rename", "replace"):
        return len(call.args) == 1 and not call.keywords
    return False


def calls_elsewhere(place, wanted):
    return [
        f"{path}:{node.lineno}: {ast.unparse(node.func)}"
        for path, tree in sources()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and wanted(node) and path != place
    ]


# Which class is moving: runtime/classes.py


def test_the_moving_class_is_said_in_one_place():
    """No second name for a class or a set of labels, and no number of a moving label."""
    names = {name for name in vars(classes) if name.isupper() and not name.startswith("_")}
    assert {"CLASSES", "UNLABELLED", "STATIC", "MOVING"} <= names
    found = [
        f"{path}:{node.lineno}: {what}"
        for path, tree in sources(*PACKAGES, "tests")
        for node, what in (*named(tree, names), *(() if path.startswith("tests/") else numbers(tree)))
        if path != "runtime/classes.py"
    ]
    assert found == []


def named(tree, names):
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


def numbers(tree):
    """Labels of movers (those that are no common number), and classes as numbers."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) is int and node.value in MOVERS.keys() - {255, 256}:
            yield node, f"knows the label {node.value}"
        if isinstance(node, ast.Compare) and isinstance(node.comparators[0], ast.Constant):
            text = ast.unparse(node.left)
            if node.comparators[0].value in (0, 1, 2, 250, 260) and (
                "to_classes" in text or "0xFFFF" in text or "65535" in text or text.endswith(("classes", "labels"))
            ):
                yield node, f"compares {text} with a number"
        text = ast.unparse(node) if isinstance(node, ast.Subscript) else ""
        if re.search(r"(matrix|probabilities|logits)\[.*\b[12]\b.*\]$", text):
            yield node, f"takes a class by its number: {text}"


def test_the_searches_find_what_they_are_for():
    """Each spelling that was there once is found."""
    once = {
        "which points take part": ["xyz[np.isfinite(xyz).all(axis=1)]", "points[points[:, :3].any(axis=1)]"],
        "how far returns reach": ["reach = UNKNOWN_REACH"],
        "what stands in for missing remission": ["np.full(n, 0.21)", "Runner(remission_fill=0)"],
        "where was the past scan": ["relative = np.linalg.inv(pose) @ other", "back = pose[:3, :3].T @ other"],
        "how a scan is read": ['np.fromfile(file, "<f4").reshape(-1, 4)'],
        "which sensor is simulated": ['device = name if name in SENSORS else "hdl64e"', "simulate(seed, frames)"],
        "how a dataclass is read from JSON": ["Settings(**json.loads(text))", "def from_dict(cls, values):"],
        "where a tuned number lives": ["CANDIDATE = 0.2", "HALO_RADIUS: float = 0.6", "p > Tuned.candidate"],
    }
    for question, lines in once.items():
        for line in lines:
            assert any(re.search(spelling, line) for spelling in PLACES[question].spellings), line
    assert once.keys() == PLACES.keys()
    for text in ("os.replace(part, path)", "part.rename(path)"):
        assert is_move(ast.parse(text).body[0].value)
    for text in ("matrix[1, 2]", "to_classes(labels) == 2", "labels > 250", "x = 252"):
        assert list(numbers(ast.parse(text))), text
    assert list(named(ast.parse("MOVING = 2"), {"MOVING"}))
