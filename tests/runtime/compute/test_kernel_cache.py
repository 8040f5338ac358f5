"""Compiled kernels on disk: found again, made anew where damaged or stale, done without where the disk is full."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from runtime.compute import internals
from runtime.compute.jit import is_cached
from tests.support.paths import ROOT


def compiled_in(call) -> list[str]:
    """Kernels that are compiled in a call, instead of coming from disk."""
    names = []
    with internals.on_compile(lambda function: names.append(function.__name__)):
        call()
    return names


def stored(source: Path) -> list[Path]:
    return sorted((source.parent / "__pycache__").glob("*.kernel"))


def test_a_kernel_is_compiled_once(load, source):
    first = load()
    assert not is_cached(first.half)
    assert compiled_in(lambda: first.half(3.0)) == ["half"]
    assert is_cached(first.half)
    second = load()
    assert is_cached(second.half)
    assert not is_cached(second.thrice)
    assert compiled_in(lambda: second.half(3.0)) == []
    assert second.half(3.0) == 1.5
    assert compiled_in(lambda: second.half(3)) == ["half"]  # another signature
    assert compiled_in(lambda: load().half(3)) == []
    assert len(stored(source)) == 2


def test_an_edit_counts(load, source):
    load().half(3.0)
    source.write_text(source.read_text().replace("x / 2", "x / 4"))
    edited = load()
    assert not is_cached(edited.half)
    assert compiled_in(lambda: edited.half(3.0)) == ["half"]
    assert edited.half(3.0) == 0.75
    assert len(stored(source)) == 1  # the stale one was written over


def flipped(content: bytes, place: int) -> bytes:
    return content[:place] + bytes([content[place] ^ 16]) + content[place + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:-1],
        lambda content: content[:40],
        lambda content: content + b"\0",
        lambda content: bytes(len(content)),
        lambda content: flipped(content, 0),
        lambda content: flipped(content, 50),
        lambda content: flipped(content, len(content) // 2),
        lambda content: flipped(content, len(content) - 1),
    ],
)
def test_a_damaged_file_is_thrown_away_and_made_anew(load, source, damage, caplog):
    load().half(3.0)
    (path,) = stored(source)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    module = load()
    assert compiled_in(lambda: module.half(3.0)) == ["half"]
    assert module.half(3.0) == 1.5
    assert [f"{path} is damaged" in message for message in caplog.messages] == [True]
    assert compiled_in(lambda: load().half(3.0)) == []


def test_code_that_this_numba_cannot_take_is_made_anew(load, source, monkeypatch, caplog):
    load().half(3.0)

    def fail(self, context, data):
        raise ValueError("opcode 7")

    monkeypatch.setattr(internals.Storable, "from_bytes", fail)
    assert compiled_in(lambda: load().half(3.0)) == ["half"]
    assert "opcode 7" in caplog.text


def in_new_process(source: Path, before: str) -> subprocess.CompletedProcess[str]:
    code = f"{before}\nimport kernels_of_a_test as k; print(k.half(3.0), k.thrice(2))"
    paths = f"import sys; sys.path[:0] = [{str(source.parent)!r}, {str(ROOT)!r}]\n"
    return subprocess.run([sys.executable, "-c", paths + code], capture_output=True, text=True, timeout=120, cwd=ROOT)


@pytest.mark.parametrize("size", [0, 1024])
def test_a_full_disk_is_warned_of_once_and_does_without(source, size):
    """No file may grow beyond `size` bytes: writing fails as on a full disk, in the middle of a file."""
    pytest.importorskip("resource")
    done = in_new_process(
        source,
        "import resource, sys; sys.dont_write_bytecode = True\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))",
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "1.5 6\n"
    assert done.stderr.count("MosWarning: compiled kernels cannot be kept") == 1
    assert "File too large" in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr
    assert [path.name for path in (source.parent / "__pycache__").iterdir()] == []


def test_without_a_writable_folder_it_is_the_same(source):
    done = in_new_process(source, "import numba.core.caching as c; c.CompileResultCacheImpl._locator_classes = []")
    assert done.returncode == 0, done.stderr
    assert done.stdout == "1.5 6\n"
    assert done.stderr.count("MosWarning: compiled kernels cannot be kept") == 1


def test_another_process_finds_them(load, source):
    load().half(3.0)
    load().thrice(2)
    done = in_new_process(
        source,
        "from runtime.compute.internals import on_compile\n"
        "on_compile(lambda function: print(function.__name__)).__enter__()",
    )
    assert done.stdout == "1.5 6\n", done.stderr


def test_processes_that_start_at_once_do_not_disturb_each_other(source):
    code = "import warnings; warnings.simplefilter('error')"
    with ThreadPoolExecutor(4) as pool:
        for done in pool.map(lambda _: in_new_process(source, code), range(4)):
            assert (done.returncode, done.stdout, done.stderr) == (0, "1.5 6\n", "")
    assert len(stored(source)) == 2
