"""The product's own source, for tests that look for what must not be there twice."""

import ast
import io
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tests.support.paths import ROOT

PACKAGES = ("runtime", "mos_model", "export", "bench")


def sources(*packages: str) -> Iterator[tuple[str, ast.Module]]:
    """Path from the root and syntax tree of each Python file of `packages` (default: all of the product)."""
    for package in packages or PACKAGES:
        for path in sorted(Path(ROOT, package).rglob("*.py")):
            yield path.relative_to(ROOT).as_posix(), ast.parse(path.read_text())


@cache
def code(path: str) -> list[tuple[int, str]]:
    """Numbered lines of a file without comments and docstrings; strings stay."""
    text = Path(ROOT, path).read_text()
    tree = ast.parse(text)
    docs: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            docs |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    return [(number, line) for number, line in enumerate(lines, 1) if number not in docs and line.strip()]
