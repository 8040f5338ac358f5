"""The compile policy: who may import Numba, and what happens where it may not compile."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import runtime
from tests.support.paths import BUNDLE, ROOT

PACKAGE = Path(runtime.__file__).parent


def modules_of(path: Path) -> set[str]:
    """Modules that a file imports, and those that it may mean in `from a import b`."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def test_numba_is_imported_in_one_folder_and_its_inside_in_one_file():
    folders = [PACKAGE, *(ROOT / name for name in ("mos_model", "export", "bench"))]
    files = [path for folder in folders for path in folder.rglob("*.py")]
    users = {path: {m for m in modules_of(path) if m.split(".")[0] in ("numba", "llvmlite")} for path in files}
    inside, jit, processor = (PACKAGE / "compute" / f"{name}.py" for name in ("internals", "jit", "processor"))
    assert {path for path, modules in users.items() if modules} == {inside, jit, processor}
    assert users[jit] | users[processor] <= {"numba", "numba.extending", "llvmlite", "llvmlite.ir", "llvmlite.binding"}


def test_without_jit_it_says_what_it_cannot():
    """Everything can be imported; what would need a kernel raises a typed error that names the variable."""
    code = (
        "import runtime, mos_model.simulator, runtime.predict, runtime.evaluation.evaluate\n"
        "try:\n"
        f"    runtime.MosRunner({str(BUNDLE)!r})\n"
        "except runtime.errors.SettingError as error:\n"
        "    print(error)\n"
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "NUMBA_DISABLE_JIT=1" in done.stdout
    assert "Unset it" in done.stdout


def test_the_command_says_so_too(tmp_path):
    scans = BUNDLE.parent / "scans" / "sequences" / "00"
    done = subprocess.run(
        [sys.executable, "-m", "runtime.commands.start", "run", str(scans), "--out", str(tmp_path / "out")],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert "NUMBA_DISABLE_JIT=1" in done.stderr
    assert "Traceback" not in done.stderr
