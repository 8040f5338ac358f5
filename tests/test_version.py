"""The version is written once, and quick to get."""

import re
import subprocess
import sys
import tomllib

import runtime
from tests.support.paths import ROOT


def test_pyproject_takes_the_version_of_the_package():
    values = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert values["project"]["dynamic"] == ["version"]
    assert "version" not in values["project"]
    file = ROOT / values["tool"]["hatch"]["version"]["path"]
    assert re.findall(r'^__version__ = "(.+)"$', file.read_text(), re.MULTILINE) == [runtime.__version__]


def test_no_other_file_writes_it():
    paths = [*ROOT.glob("*.toml"), *ROOT.glob(".ci/*")]
    for package in ("runtime", "mos_model", "export", "bench"):
        paths += (ROOT / package).rglob("*.py")
    holding = [str(path.relative_to(ROOT)) for path in paths if f'"{runtime.__version__}"' in path.read_text()]
    assert holding == ["runtime/__init__.py"]


def test_it_needs_neither_numba_nor_onnx_runtime():
    slow = {"numpy", "numba", "onnxruntime"}
    code = f"import sys, runtime; print(runtime.__version__); print({slow} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.split("\n")[:2] == [runtime.__version__, "set()"]
