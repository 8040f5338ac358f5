"""ONNX Runtime: what is asked of it, what is refused, and that it keeps to itself."""

import ast
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import runtime
from runtime.compute.sessions import CPU, Execution, available_providers, open_session
from runtime.errors import BundleError, MosWarning, ProviderError, SettingError
from tests.support.paths import BUNDLE, ROOT

NETWORK = BUNDLE / "image_net.onnx"
CUDA = "CUDAExecutionProvider"
NO_CUDA = pytest.mark.skipif(CUDA in available_providers(), reason="ONNX Runtime with CUDA is here")


def run(session):
    image = np.random.default_rng(0).normal(size=(1, 13, 64, 256)).astype(np.float32)
    return session.run(["probabilities"], {"image": image})[0]


def test_a_model_is_a_file_or_its_bytes():
    want = run(open_session(NETWORK, threads=1))
    np.testing.assert_array_equal(run(open_session(str(NETWORK), threads=1)), want)
    np.testing.assert_array_equal(run(open_session(NETWORK.read_bytes(), threads=1)), want)


@NO_CUDA
@pytest.mark.parametrize("provider", [CUDA, (CUDA, {"device_id": 0})])
def test_a_provider_that_is_not_there_is_an_error_that_says_what_to_install(provider):
    with pytest.raises(ProviderError, match=r"CUDAExecutionProvider is not .*\(it has .*onnxruntime-gpu"):
        open_session(NETWORK, threads=1, execution=Execution([provider, CPU]))


@NO_CUDA
def test_the_fallback_must_be_allowed_and_warns():
    with pytest.warns(MosWarning, match="onnxruntime-gpu"):
        session = open_session(NETWORK, threads=1, execution=Execution([CUDA], allow_fallback=True))
    assert session.get_providers() == [CPU]
    np.testing.assert_allclose(run(session), run(open_session(NETWORK, threads=1)), atol=1e-6)


def test_an_unknown_provider_is_an_error():
    with pytest.raises(ProviderError, match="AbacusExecutionProvider"):
        open_session(NETWORK, threads=1, execution=Execution(["AbacusExecutionProvider"]))


def test_the_cpu_is_no_fallback():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        open_session(NETWORK, threads=1, execution=Execution([(CPU, {})]))


def test_session_options_reach_onnx_runtime():
    spinning = Execution(session_options={"session.intra_op.allow_spinning": "1"})
    run(open_session(NETWORK, threads=1, execution=spinning))
    with pytest.raises(SettingError, match="session option"):
        open_session(NETWORK, threads=1, execution=Execution(session_options={"": "x"}))


@pytest.mark.parametrize("content", [b"", b"no network", None])
def test_a_broken_model_is_an_error(tmp_path, content):
    content = NETWORK.read_bytes()[:5000] if content is None else content
    path = tmp_path / "image_net.onnx"
    path.write_bytes(content)
    with pytest.raises(BundleError, match=r"image_net\.onnx"):
        open_session(path, threads=1)
    with pytest.raises(BundleError, match="the model: ONNX Runtime cannot load it"):
        open_session(content, threads=1)


def in_empty_home(code: str, home: Path, **environment: str) -> list[str]:
    """Paths of the files that a process leaves in its home folder."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")}
    environment = {**inherited, "HOME": str(home), **environment}
    subprocess.run([sys.executable, "-c", code], env=environment, cwd=ROOT, check=True, timeout=300)
    return [path.relative_to(home).as_posix() for path in home.rglob("*") if path.is_file()]


def test_onnx_runtime_leaves_no_device_id(tmp_path):
    """A runner at work for some seconds: in the home folder there is nothing but Numba's cache, if anything."""
    code = (
        "import time, numpy as np\n"
        "from runtime import MosRunner\n"
        f"runner = MosRunner({str(BUNDLE)!r}, threads=1)\n"
        "scan, start = np.random.default_rng(0).normal(0, 5, (500, 4)).astype(np.float32), time.monotonic()\n"
        "while time.monotonic() < start + 3:\n"
        "    runner(scan, np.eye(4)); time.sleep(0.1)\n"
    )
    left = in_empty_home(code, tmp_path)
    assert [path for path in left if not path.startswith(".cache/numba/")] == []


def test_the_users_own_choice_of_telemetry_stays(tmp_path):
    code = "import os, runtime.compute.sessions; assert os.environ['ORT_DISABLE_TELEMETRY'] == '0'"
    in_empty_home(code, tmp_path, ORT_DISABLE_TELEMETRY="0")


def imports_of(path: Path) -> set[str]:
    """Packages that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


def test_one_file_imports_onnx_runtime():
    """All others come to it by `runtime.compute.sessions`, which switches its telemetry off first."""
    package = Path(runtime.__file__).parent
    folders = [package, *(ROOT / name for name in ("mos_model", "export", "bench", "tests"))]
    files = [path for folder in folders for path in folder.rglob("*.py")]
    assert [path for path in files if "onnxruntime" in imports_of(path)] == [package / "compute" / "sessions.py"]
