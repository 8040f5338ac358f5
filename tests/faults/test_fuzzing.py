"""Damaged files by seeded mutation: the short form of `python -m bench.faults`, without processes of their own."""

import warnings

import pytest

from bench.faults import KINDS, try_kind
from export.bundle.write import plain
from runtime.errors import CheckpointError

# Scans that are left out, what is made anew, times that are done without
NEVER_REFUSED = ("run, scan", "run, its journal", "sequence, times.txt")


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_damaged_is_read_or_refused(kind):
    if kind.startswith("live"):
        pytest.importorskip("cyclonedds", reason="the extra `live` is not installed")
    lines: list[dict] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        warnings.simplefilter("error", RuntimeWarning)
        try_kind(kind, 2, range(15 + KINDS[kind].share), lines.append)
    assert [line for line in lines if "failed" in line] == []
    assert kind in NEVER_REFUSED or lines[-1]["refused"] > 0


def test_a_record_of_few_bytes_and_many_values():
    record: list = []
    for _ in range(60):
        record = [record, record]
    with pytest.raises(CheckpointError, match="more than"):
        plain({"step": record})
    assert plain({"step": [1, (2.5, "x")], "best": float("inf")}) == {"step": [1, [2.5, "x"]]}
