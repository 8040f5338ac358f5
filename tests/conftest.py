"""What tests of all rooms share."""

import sys
from collections.abc import Callable
from types import ModuleType

import pytest

from tests.support import markdown
from tests.support.paths import ROOT

CONTRIBUTING = ROOT / "CONTRIBUTING.md"


@pytest.fixture
def contributed(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """`contributed(path)`: the file that CONTRIBUTING.md tells to write at `path`, as the module that it would be."""

    def load(path: str) -> ModuleType:
        (block,) = (one for one in markdown.blocks(CONTRIBUTING, "python") if one.code.startswith(f"# {path}\n"))
        module = ModuleType(path.removesuffix(".py").replace("/", "."))
        monkeypatch.setitem(sys.modules, module.__name__, module)
        markdown.run(CONTRIBUTING, block, vars(module))
        return module

    return load
