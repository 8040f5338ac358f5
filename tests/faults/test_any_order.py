"""A runner in any order of scans, errors, resets, interrupts and threads: as one that saw the scans alone."""

import functools
import os
import signal
import threading
import time
import warnings

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from runtime import MosRunner, MosWarning
from runtime.errors import InferenceError, MosError
from runtime.head.refiners import Pixels
from runtime.image.history import History
from runtime.image.image_net import ImageNet
from runtime.image.inputs import InputBuilder
from tests.runtime.test_runner import drive
from tests.support.paths import BUNDLE
from tests.support.stateful import examples

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals of POSIX")

FRAMES = drive(12, points=500)
WRONG = {
    "no scan": (np.zeros(7, np.float32), FRAMES[0][1]),
    "text": (np.array([["a"] * 4]), FRAMES[0][1]),
    "five columns too many": (np.zeros((3, 9), np.float32), FRAMES[0][1]),
    "no pose": (FRAMES[0][0], np.zeros((4, 4))),
    "a pose that is NaN": (FRAMES[0][0], np.full((4, 4), np.nan)),
    "no number in the pose": (FRAMES[0][0], np.full((4, 4), "x")),
    "a pose beyond all maps": (FRAMES[0][0], np.diag([1, 1, 1, 1.0]) + 1e200 * np.eye(4, k=3)),
}
ODD = {
    "no points": lambda scan: scan[:0],
    "no remission": lambda scan: scan[:, :3],
    "float64": lambda scan: scan.astype(np.float64),
    "NaN and infinity": lambda scan: np.where(np.arange(scan.size).reshape(scan.shape) % 37, scan, np.nan) * 1,
    "all far away": lambda scan: scan * np.float32(1e4),
}
STEPS = {  # where a scan can be cut off: before or after each of these
    "input": (InputBuilder, "project"),
    "network": (ImageNet, "run"),
    "points": (Pixels, "refine"),
    "history": (History, "add"),
}


class Told(MosRunner):
    """Says which scans were remembered, in which order."""

    def __init__(self, **options):
        self.told = []
        super().__init__(BUNDLE, threads=2, postprocess="none", **options)

    def _remember(self, arrived, *others):
        index = super()._remember(arrived, *others)
        self.told.append(arrived[1][0, 3])  # x of the pose
        return index


@functools.cache
def runners(delay):
    return tuple(Told(belief="online", delay=delay) for _ in range(2))


class AnyOrder(RuleBasedStateMachine):
    """`subject` meets all of it, `other` only the scans that counted."""

    @initialize(delay=st.sampled_from([0, 2]))
    def begin(self, delay):
        self.subject, self.other = runners(delay)
        self.at = 0.0
        for one in (self.subject, self.other):
            one.reset()
            one.told.clear()

    def frame(self, step, change=lambda scan: scan):
        """The next scan, so many steps on."""
        self.at += step
        scan, pose = FRAMES[int(self.at * 2) % len(FRAMES)]
        pose = pose.copy()
        pose[0, 3] = self.at
        return change(scan), pose

    def same(self, found, *frame):
        """What the other says of it."""
        want = self.other(*frame)
        assert (found is None) == (want is None)
        if found is not None:
            np.testing.assert_array_equal(found.probability, want.probability)
            np.testing.assert_array_equal(found.moving, want.moving)
            assert (found.index, found.ready) == (want.index, want.ready)

    @rule(step=st.sampled_from([0.0, 0.5, 0.5, 0.5, 40.0]), odd=st.sampled_from(["", "", *ODD]))
    def label(self, step, odd):
        frame = self.frame(step, ODD.get(odd, lambda scan: scan))
        self.same(self.subject(*frame), *frame)

    @rule()
    def remember(self):
        frame = self.frame(0.5)
        for one in (self.subject, self.other):
            one.remember(*frame)

    @rule(kind=st.sampled_from(list(WRONG)))
    def wrong(self, kind):
        with pytest.raises(MosError):
            self.subject(*WRONG[kind])

    @rule(step=st.sampled_from(list(STEPS)[:3]))
    def fails(self, step):
        """Something that nobody thought of, in the middle of a scan."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(*STEPS[step], lambda *_: 1 / 0)
            with pytest.raises((ZeroDivisionError, InferenceError)):
                self.subject(*self.frame(0.0))

    @rule()
    def a_warning_that_is_an_error(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error", MosWarning)
            scan, pose = self.frame(0.0)
            pose[0, 3] += 500
            if self.subject.told:
                with pytest.raises(MosWarning):
                    self.subject(scan, pose)

    @rule(step=st.sampled_from(list(STEPS)), before=st.booleans())
    def interrupt(self, step, before):
        """Ctrl-C: the scan counts as a whole or not at all."""
        where, name = STEPS[step]
        whole = getattr(where, name)

        def interrupted(*arguments):
            if before:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.001)
            found = whole(*arguments)
            if not before:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.001)
            return found

        frame, known = self.frame(0.5), len(self.subject.told)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(where, name, interrupted)
            with pytest.raises(KeyboardInterrupt):
                self.subject(*frame)
        if len(self.subject.told) > known:
            self.other(*frame)

    @rule(count=st.integers(2, 3))
    def threads(self, count):
        """At once: one after the other, in some order."""
        frames = [self.frame(0.25) for _ in range(count)]
        found, known = {}, len(self.subject.told)

        def call(frame):
            found[frame[1][0, 3]] = self.subject(*frame)

        threads = [threading.Thread(target=call, args=(frame,)) for frame in frames]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        by_place = {frame[1][0, 3]: frame for frame in frames}
        for place in self.subject.told[known:]:
            self.same(found[place], *by_place[place])

    @rule(keep=st.booleans())
    def reset(self, keep):
        for one in (self.subject, self.other):
            one.reset(keep_sensor=keep)
            one.told.clear()

    @rule()
    def flush(self):
        for found, want in zip(self.subject.flush(), self.other.flush(), strict=True):
            np.testing.assert_array_equal(found.probability, want.probability)
            assert found.index == want.index

    @invariant()
    def both_remember_the_same(self):
        if hasattr(self, "subject"):
            assert self.subject.told == self.other.told


@pytest.fixture(autouse=True, scope="module")
def heeded():
    """Ctrl-C counts, also where the tests were started in the background; and jumps are no errors."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MosWarning)
        yield
    signal.signal(signal.SIGINT, before)
    runners.cache_clear()


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = examples(25)
