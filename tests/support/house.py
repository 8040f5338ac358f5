"""The floors of the house, as CONTRIBUTING draws them."""

import re

from tests.support.paths import ROOT


def floors() -> dict[str, list[set[str]]]:
    """Of each package that has rooms its floors, from the ground up; the last is the package's own `__init__.py`."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    picture = re.search(r"^```\n(runtime/.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert picture, "CONTRIBUTING.md has no picture of the house"
    found: dict[str, list[set[str]]] = {}
    package = ""
    for line in picture[1].splitlines():
        names = {one.removesuffix("/").removesuffix(".py") for one in re.split(r"  +", line.strip())[0].split()}
        if line.startswith("    "):
            found[package].insert(0, names)
        elif names:
            (package,) = names
            found[package] = []
    return {package: [*rooms, {""}] for package, rooms in found.items() if rooms}
