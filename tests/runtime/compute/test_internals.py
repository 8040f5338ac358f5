"""Numba's inside: what is done without where another version lacks it, named once in the log."""

import sys

import pytest
from numba.core import caching, registry

from runtime.compute import internals
from runtime.compute.compiling import compiling


@pytest.fixture(autouse=True)
def afresh():
    internals.say_missing.cache_clear()
    internals.target.cache_clear()
    yield
    internals.target.cache_clear()


def test_without_the_parts_of_the_cache_numbas_own_is_used(load, tmp_path, monkeypatch, caplog):
    monkeypatch.delattr(caching, "CompileResultCacheImpl")
    for _ in range(2):
        module = load()
        assert (module.half(3.0), module.thrice(2)) == (1.5, 6)
    assert [message for message in caplog.messages if "its own cache of kernels" in message] == caplog.messages[:1]
    assert len(list((tmp_path / "__pycache__").glob("*.nbi"))) == 2
    assert not list((tmp_path / "__pycache__").glob("*.kernel"))


def test_without_a_place_for_a_cache_numbas_own_is_used(load, monkeypatch, caplog):
    monkeypatch.setattr(internals, "set_cache", lambda kernel, cache: kernel.no_such_thing)
    assert load().half(3.0) == 1.5
    assert "its own cache of kernels" in caplog.text


def test_without_a_way_to_bytes_it_goes_without_files(load, source, monkeypatch, caplog):
    monkeypatch.delattr(caching.CompileResultCacheImpl, "reduce")
    monkeypatch.setattr(caching.CompileResultCacheImpl, "__abstractmethods__", frozenset())
    monkeypatch.delattr(caching.CacheImpl, "reduce")
    assert load().half(3.0) == 1.5
    assert "compiled in every process" in caplog.text
    assert not list((source.parent / "__pycache__").glob("*.kernel"))


def test_without_events_it_is_not_known_what_is_compiled(load, monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "numba.core.event", None)
    names = []
    with compiling(names.append):
        assert load().half(3.0) == 1.5
    assert names == []
    assert "which kernel is being compiled" in caplog.text


def test_without_a_target_the_processor_is_asked(monkeypatch, caplog):
    want = internals.target()
    internals.target.cache_clear()
    monkeypatch.delattr(registry, "cpu_target")
    platform, processor, features = internals.target()
    assert (platform, processor) == want[:2]
    assert ("+avx512f" in features) == ("+avx512f" in want[2])
    assert "it is taken to compile" in caplog.text


def test_errors_of_a_block_come_out():
    """They are the caller's, even where they look like those of a Numba that lacks something."""
    with pytest.raises(TypeError, match="mine"), compiling(lambda name: None):
        raise TypeError("mine")
