"""`mos run` ended at any moment, on a disk that is full at any byte, two at once: what is there is whole, and it goes
on to the files of a run that nothing befell.
"""

import json
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from runtime import MosRunner
from runtime.bundle.manifest import MANIFEST
from runtime.recordings.journal import JOURNAL
from runtime.recordings.registry import open_recording
from runtime.recordings.run_note import NOTE
from tests.support.disk import small_disk
from tests.support.moments import Strike, code_of, start
from tests.support.paths import BUNDLE, TINY
from tests.support.stateful import examples

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs processes of POSIX")

SCANS = 4
WAYS = {
    "pixels": ["--belief", "none"],
    "belief": ["--delay", "1"],
    "beside": ["--belief", "none", "--nearest", "12", "--write", "cloud", "--write", "map", "--write", "static"],
}
# By each of them a process ends with one of these codes, unless it was done before
ENDS = {signal.SIGKILL: {-signal.SIGKILL}, signal.SIGTERM: {-signal.SIGTERM}, signal.SIGINT: {130}}
LAST = 60  # events of a run, about

ways, strikes = st.sampled_from(list(WAYS)), st.sampled_from(list(ENDS))


def files(out):
    """All that is there, by its place, but for the lock and the time."""
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def labels(out):
    return {Path(name).name: data for name, data in files(out).items() if name.endswith(".label")}


def known(found):
    """Files, with what the journal says instead of its bytes: an interrupted one has lines that count no more."""
    lines = [json.loads(line) for line in found[f"sequences/00/{JOURNAL}"].splitlines()]
    return found | {f"sequences/00/{JOURNAL}": {line["scan"]: line for line in lines}}


class AnyMoment(RuleBasedStateMachine):
    bundle: Path
    scans: Path
    whole: ClassVar[dict[str, dict[str, bytes]]] = {}  # files of each way, by itself

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="moment"))
        self.out = self.folder / "out"

    @classmethod
    def start(cls, out, way, overwrite=False, **fault):
        common = ["--bundle", cls.bundle, "--threads", "1", "--postprocess", "none", "--limit", SCANS, "--out", out]
        more = ["--overwrite"] if overwrite else []
        return start(["run", *map(str, [cls.scans, *common]), *WAYS[way], *more], **fault)

    def check(self, way, code):
        """Done, and then all of it is there; or refused, as where another way was begun."""
        assert code in (0, 1)
        if code == 0:
            found = known(files(self.out))
            assert [name for name, data in known(self.whole[way]).items() if found.get(name) != data] == []

    @rule(way=ways, overwrite=st.booleans())
    def run(self, way, overwrite):
        before = labels(self.out)
        code = code_of(self.start(self.out, way, overwrite))
        self.check(way, code)
        if code:  # only so that nothing of another way is lost
            assert not overwrite
            assert labels(self.out) == before != {}

    @rule(way=ways, overwrite=st.booleans(), number=strikes, event=st.integers(0, LAST))
    def struck_before_an_event(self, way, overwrite, number, event):
        code = code_of(self.start(self.out, way, overwrite, strike=Strike(number, event, self.out)))
        if code not in ENDS[number]:
            self.check(way, code)

    @rule(way=ways, overwrite=st.booleans(), number=strikes, moment=st.floats(0, 0.6))
    def struck_at_a_moment(self, way, overwrite, number, moment):
        code = code_of(self.start(self.out, way, overwrite, strike=Strike(number, seconds=moment)))
        if code not in ENDS[number]:
            self.check(way, code)

    @rule(way=ways, overwrite=st.booleans(), room=st.integers(0, 32_000))
    def disk_full(self, way, overwrite, room):
        self.check(way, code_of(self.start(self.out, way, overwrite, room=room)))

    @rule(one=ways, other=ways, overwrite=st.booleans(), number=strikes, event=st.integers(0, 2 * LAST))
    def two_at_once(self, one, other, overwrite, number, event):
        """One of which is struck sooner or later."""
        first = self.start(self.out, one, overwrite, strike=Strike(number, event, self.out))
        second = self.start(self.out, other)
        codes = code_of(first), code_of(second)
        assert codes[0] in {0, 1, *ENDS[number]}
        assert codes[1] in (0, 1)
        if not overwrite:  # else what the second has done may be gone again
            self.check(other, codes[1])

    @invariant()
    def all_that_is_there_is_whole(self):
        """And of one way: each scan has another label in another."""
        found = labels(self.out).items()
        assert any(found <= labels_of(whole).items() for whole in self.whole.values())
        for note in self.out.rglob(NOTE):
            assert isinstance(json.loads(note.read_text()), dict)

    def teardown(self):
        """From whatever there is, the same command goes on to all of it, and no temporary file is left."""
        found = labels(self.out).items()
        way = next(way for way, whole in self.whole.items() if found <= labels_of(whole).items())
        code = code_of(self.start(self.out, way))
        assert code == 0
        self.check(way, code)
        assert [path for path in self.out.rglob(".*")] == []
        shutil.rmtree(self.folder)


def labels_of(whole):
    return {Path(name).name: data for name, data in whole.items() if name.endswith(".label")}


@pytest.fixture(scope="module", autouse=True)
def whole(tmp_path_factory):
    """The files of each way, by itself; of a bundle with thresholds that its untrained network passes here."""
    folder = tmp_path_factory.mktemp("whole")
    AnyMoment.bundle = Path(shutil.copytree(BUNDLE, folder / "bundle"))
    AnyMoment.scans = Path(shutil.copytree(TINY / "scans" / "sequences" / "00", folder / "sequences" / "00"))
    frames = [(scan.data, scan.known_pose()) for scan in open_recording(AnyMoment.scans).scans()][:SCANS]
    with MosRunner(BUNDLE, threads=1, postprocess="none", belief="none") as runner:
        half = float(np.median(np.concatenate([runner(*frame).probability for frame in frames])))
    manifest = json.loads((BUNDLE / MANIFEST).read_text())
    manifest["sensors"][0]["decision"] = {"threshold": half, "belief_threshold": half, "delayed_threshold": half}
    (AnyMoment.bundle / MANIFEST).write_text(json.dumps(manifest))
    for way in WAYS:
        out = folder / way
        assert code_of(AnyMoment.start(out, way)) == 0
        AnyMoment.whole[way] = files(out)
    found = [labels_of(whole) for whole in AnyMoment.whole.values()]
    assert {len(one) for one in found} == {SCANS}
    for one, other in ((0, 1), (0, 2), (1, 2)):
        assert all(found[one][name] != found[other][name] for name in found[one])  # so that they can be told apart


TestAnyMoment = AnyMoment.TestCase
TestAnyMoment.settings = examples(4, steps=6, shrink=False)


@pytest.mark.parametrize("pages", [0, 1, 9, 30])
def test_a_disk_that_grows(tmp_path, pages):
    """Full after so many pages of all files together, and then with room enough."""
    with small_disk(tmp_path / "disk", 4096 * (pages + 4)) as disk:
        assert code_of(AnyMoment.start(disk / "out", "beside")) == 1
        assert all(
            AnyMoment.whole["beside"][f"sequences/00/predictions/{name}"] == data for name, data in labels(disk).items()
        )
        subprocess.run(["mount", "-o", "remount,size=10000000", str(disk)], check=True)
        assert code_of(AnyMoment.start(disk / "out", "beside")) == 0
        assert known(files(disk / "out")) == known(AnyMoment.whole["beside"])
