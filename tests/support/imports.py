"""Who imports whom, read from the source: `import` anywhere in a file counts, within functions too."""

import ast
from pathlib import Path

from tests.support.paths import ROOT

PACKAGES = ("runtime", "mos_model", "export")


def files(package: str) -> list[Path]:
    """The Python files of a package, relative to the root."""
    return sorted(path.relative_to(ROOT) for path in (ROOT / package).rglob("*.py"))


def module(path: Path) -> str:
    """The dotted name of a file."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> set[str]:
    """Modules that a file imports; of ours, the file that a name comes from."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if _exists(inner) else node.module)
    return found


def ours(path: Path) -> set[str]:
    """Those of this project."""
    return {name for name in imports(path) if name.split(".")[0] in PACKAGES}


def room(name: str) -> str:
    """The room of a module within its package, or its own name where it lies in none."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else ""


def _exists(name: str) -> bool:
    place = ROOT.joinpath(*name.split("."))
    return place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()
