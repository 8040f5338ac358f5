"""The product's own source, for tests that look for what must not be there twice."""

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.support.paths import ROOT

PACKAGES = ("runtime", "mos_model", "export", "bench")


def sources(*packages: str) -> Iterator[tuple[str, ast.Module]]:
    """Path from the root and syntax tree of each Python file of `packages` (default: all of the product)."""
    for package in packages or PACKAGES:
        for path in sorted(Path(ROOT, package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text())
