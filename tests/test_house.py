"""The house as CONTRIBUTING draws it: rooms on floors, arrows that go down only, files that one can read."""

from collections import Counter
from pathlib import Path

import pytest

from tests.support.house import floors
from tests.support.imports import PACKAGES, files, module, ours, room
from tests.support.paths import ROOT

FLOORS = floors()  # a room imports only from floors below its own
MAY_IMPORT = {"runtime": {"runtime"}, "mos_model": {"runtime", "mos_model"}, "export": set(PACKAGES)}
MOST_FILES = {"runtime": 8, "mos_model": 4, "export": 4}  # directly in the folder
MOST_LINES = 300
ALIKE = ("__init__.py", "registry.py")


def floor(name: str) -> int:
    """The floor of a module."""
    for number, rooms in enumerate(FLOORS[name.split(".")[0]]):
        if room(name) in rooms:
            return number
    raise AssertionError(f"{name}: has no floor; CONTRIBUTING.md does not draw its room")


@pytest.mark.parametrize("package", PACKAGES)
def test_what_is_drawn_is_there(package):
    assert set().union(*FLOORS[package]) == {room(module(path)) for path in files(package)}


@pytest.mark.parametrize("package", PACKAGES)
def test_arrows_go_down_only(package):
    wrong = []
    for path in files(package):
        here = module(path)
        for there in ours(path):
            if there.split(".")[0] not in MAY_IMPORT[package]:
                wrong.append(f"{path} imports {there}, of a package above")
            elif there.split(".")[0] == package and room(there) != room(here) and floor(there) >= floor(here):
                if there == package and here != package:  # the names of `runtime/__init__.py` that need nothing
                    continue
                wrong.append(f"{path} imports {there}, of a floor that is not below")
    assert not wrong, "\n".join(wrong)


def test_no_circle_of_files():
    left = {module(path): ours(path) for package in PACKAGES for path in files(package)}
    while ready := [name for name, needs in left.items() if not (needs - {name}) & left.keys()]:
        for name in ready:
            del left[name]
    late = {name for name in left if name in PACKAGES}  # what `runtime` gives late, see its `__getattr__`
    assert left.keys() <= late, f"in a circle, or above one: {sorted(left)}"


@pytest.mark.parametrize("package", PACKAGES)
def test_a_folder_is_taken_in_at_a_glance(package):
    direct = [path.name for path in files(package) if len(path.parts) == 2]
    assert len(direct) <= MOST_FILES[package], direct


def test_no_file_is_too_long_to_read():
    paths = [path for package in (*PACKAGES, "bench") for path in files(package)]
    lines = {str(path): len((ROOT / path).read_text().splitlines()) for path in paths}
    assert not {path: count for path, count in lines.items() if count > MOST_LINES}


def test_rooms_are_packages_and_names_say_which():
    """No two files of different rooms of a package share a name, but for registries; a command has that of its work."""
    for package in PACKAGES:
        named = [path for path in files(package) if path.name not in ALIKE and path.parts[1] != "commands"]
        names = Counter(path.name for path in named)
        assert not [name for name, count in names.items() if count > 1]
        for path in files(package):
            assert (ROOT / path).with_name("__init__.py").is_file(), path


def test_tests_mirror_the_rooms():
    rooms = {Path(*path.parts[:-1]) for package in PACKAGES for path in files(package)}
    tested = {path.parent.relative_to("tests") for path in files("tests") if path.name.startswith("test_")}
    assert tested - {Path(), Path("bench"), Path("faults")} <= rooms
