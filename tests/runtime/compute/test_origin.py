"""What compiled code is made from: an edit anywhere that matters is noticed, and one that does not is not."""

import subprocess
import sys

import pytest

from runtime.compute import atomics, origin
from runtime.head.sparse.kernel import run_layers
from tests.support.paths import ROOT

FILES = {
    "values_of_a_test": """
import numpy as np

FACTOR, TABLE, INSIDE, UNUSED = 2, np.arange(5000), 4, 5
""",
    "helpers_of_a_test": """
from runtime.compute.jit import kernel
from values_of_a_test import INSIDE

@kernel
def shift(x):
    return x + deepest(x)

@kernel
def deepest(x):
    return INSIDE * x
""",
    "kernels_of_a_test": """
from helpers_of_a_test import shift
from runtime.compute.jit import kernel
from values_of_a_test import FACTOR, TABLE, UNUSED

@kernel
def scaled(x):
    return FACTOR * x

@kernel
def looked_up(x):
    return [TABLE[x + i] for i in range(2)][1]

@kernel
def shifted(x):
    return shift(x) if x > 0 else shifted(x + 1)

@kernel
def alone(x):
    return x
""",
}
NAMES = {"scaled", "looked_up", "shifted", "alone"}


@pytest.fixture
def kernels(tmp_path):
    """The ingredients of each kernel in a new process, where `old` in the files is `new`."""

    def made_from(old: str = "", new: str = "") -> dict[str, str]:
        for name, text in FILES.items():
            assert not old or text.count(old) < 2
            (tmp_path / f"{name}.py").write_text(text.replace(old, new) if old else text)
        code = (
            f"import sys; sys.dont_write_bytecode = True; sys.path[:0] = [{str(tmp_path)!r}, {str(ROOT)!r}]\n"
            "import kernels_of_a_test as kernels\nfrom runtime.compute.origin import ingredients\n"
            f"for name in {sorted(NAMES)}: print(ingredients(getattr(kernels, name).py_func))"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        return dict(zip(sorted(NAMES), done.stdout.split(), strict=True))

    return made_from


@pytest.mark.parametrize(
    ("old", "new", "changed"),
    [
        ("", "", set()),
        ("UNUSED = 2, np.arange(5000), 4, 5", "UNUSED = 2, np.arange(5000), 4, 9", set()),
        ("UNUSED = 2, np", "UNUSED = 7, np", {"scaled"}),
        ("np.arange(5000)", "np.arange(5000) % 4999", {"looked_up"}),
        ("np.arange(5000)", "np.arange(5000, dtype=np.int32)", {"looked_up"}),
        ("5000), 4", "5000), 6", {"shifted"}),  # two calls away
        ("x + deepest", "x - deepest", {"shifted"}),
    ],
)
def test_what_a_kernel_takes_from_other_files_counts(kernels, old, new, changed):
    before, after = kernels(), kernels(old, new)
    assert {name for name in NAMES if after[name] != before[name]} == changed


@pytest.mark.parametrize("edited", [atomics.__file__, str(origin.POLICY)])
def test_generated_code_and_the_policy_count(edited, monkeypatch):
    """`run_layers` calls counters of another file, which generate their code themselves."""
    before, digest = origin.ingredients(run_layers.py_func), origin._digest
    assert origin.ingredients(run_layers.py_func) == before
    monkeypatch.setattr(origin, "_digest", lambda path: "edited" if path == edited else digest(path))
    assert origin.ingredients(run_layers.py_func) != before
