"""Signals, threads and forks at unlucky moments."""

import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest

from runtime import MosRunner, MosWarning
from runtime.compute.internals import cache_of, on_compile
from runtime.compute.jit import kernel
from runtime.compute.undisturbed import undisturbed
from runtime.errors import SettingError
from runtime.image.history import History
from tests.runtime.test_runner import drive
from tests.support.paths import BUNDLE, ROOT, TINY

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals and forks of POSIX")


@pytest.fixture(scope="module")
def runner():
    return MosRunner(BUNDLE, threads=2, belief="online")


@pytest.fixture(autouse=True)
def heeded():
    """Ctrl-C counts, also where the tests were started in the background, as by a script, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupt():
    """Ctrl-C, now."""
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.01)  # in which the main thread is told


def probabilities(runner, frames):
    return [runner(*frame).probability for frame in frames]


@pytest.mark.parametrize("moment", ["before", "after"])
def test_an_interrupt_while_the_history_is_written(runner, monkeypatch, moment):
    """The scan counts as a whole: the next one is labelled as if nothing had been."""
    frames = drive(5)
    runner.reset()
    want = probabilities(runner, frames)[-1]
    add = History.add

    def interrupted(self, *arguments):
        if moment == "before":
            interrupt()
        add(self, *arguments)
        if moment == "after":
            interrupt()

    runner.reset()
    probabilities(runner, frames[:3])
    monkeypatch.setattr(History, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        runner(*frames[3])
    monkeypatch.undo()
    np.testing.assert_array_equal(runner(*frames[4]).probability, want)


def test_an_interrupt_of_a_reset(runner, monkeypatch):
    frames = drive(3)
    runner.reset()
    want = probabilities(runner, frames)
    clear = History.clear
    monkeypatch.setattr(History, "clear", lambda self: (interrupt(), clear(self)))
    with pytest.raises(KeyboardInterrupt):
        runner.reset()
    monkeypatch.undo()
    np.testing.assert_array_equal(probabilities(runner, frames), want)


def test_a_step_is_done_or_has_not_begun():
    """Interrupts at any moment around it."""
    state = []

    def step():
        state.append("begun")
        time.sleep(0.002)
        state.append("done")

    interrupted = 0
    for delay in np.linspace(0, 0.004, 60):
        timer = threading.Timer(delay, os.kill, (os.getpid(), signal.SIGINT))
        try:
            timer.start()
            undisturbed(step)
            timer.join()
            time.sleep(0.001)
        except KeyboardInterrupt:
            interrupted += 1
        assert len(state) % 2 == 0
    assert interrupted == 60


def test_what_a_step_raises():
    with pytest.raises(ZeroDivisionError):
        undisturbed(lambda: 1 / 0)
    assert undisturbed(lambda: 3) == 3


def jumping(runner):
    """Calls that warn of a jump."""
    frames = drive(2)
    runner.reset()
    runner(*frames[0])
    pose = frames[1][1].copy()
    pose[0, 3] += 1000
    return runner(frames[1][0], pose)


def with_handler(monkeypatch, handle):
    monkeypatch.setattr(warnings, "showwarning", handle)
    return warnings.catch_warnings()


def test_a_handler_of_warnings_that_resets(runner, monkeypatch):
    called = []
    with warnings.catch_warnings():
        warnings.simplefilter("always", MosWarning)
        monkeypatch.setattr(warnings, "showwarning", lambda *_: (called.append(1), runner.reset()))
        assert jumping(runner).index == 0  # the first scan since then
    assert called


def test_a_handler_of_warnings_that_labels(runner, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("always", MosWarning)
        monkeypatch.setattr(warnings, "showwarning", lambda *_: runner(*drive(1)[0]))
        with pytest.raises(SettingError, match="within a call"):
            jumping(runner)
    assert len(probabilities(runner, drive(2))) == 2  # it is open again


def in_a_process(code):
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )


BEGIN = """
import os, signal, threading, time
from tests.runtime.test_runner import BUNDLE, drive
from runtime import MosRunner
runner, frames = MosRunner(BUNDLE, threads=2, postprocess="none"), drive(2, points=100_000)
def always():
    while True:
        runner.reset()
        runner(*frames[0])
threading.Thread(target=always, daemon=True).start()
time.sleep(0.2)
"""


def test_a_daemon_thread_within_a_scan_at_the_end():
    done = in_a_process(BEGIN)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_fork_while_another_thread_is_within_a_scan():
    done = in_a_process(
        BEGIN
        + """
for _ in range(3):
    time.sleep(0.013)
    child = os.fork()
    if child == 0:
        signal.alarm(300)  # a child that hangs is ended
        runner.reset()
        runner(*frames[1])
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""
    )
    assert (done.returncode, done.stderr) == (0, "")


# Interrupts a command where a function is called (again) whose file and name end so
AT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
file, name, again, *arguments = sys.argv[1:]
left = int(again) + 1
def look(frame, event, _):
    global left
    code = frame.f_code
    if event == "call" and code.co_filename.endswith(file) and code.co_name == name:
        left -= 1
        if not left:
            sys.setprofile(None)
            print("now", flush=True)
            os.kill(os.getpid(), signal.SIGINT)
from runtime.commands.start import main
sys.setprofile(look)
sys.exit(main(arguments))
"""


@pytest.mark.parametrize(
    ("file", "name", "again"),
    [
        ("<frozen importlib._bootstrap_external>", "exec_module", 100),  # an import
        ("numpy/__init__.py", "<module>", 0),
        ("typer/core.py", "_main", 0),  # nothing has begun
        ("llvmlite/binding/ffi.py", "__enter__", 0),  # with the lock of all that compiles
        ("llvmlite/binding/ffi.py", "__del__", 0),
        ("threading.py", "__exit__", 10),  # of a lock
        ("runtime/runner.py", "_step", 1),
        ("runtime/files.py", "write_whole", 1),
    ],
)
def test_an_interrupt_at_any_moment(tmp_path, file, name, again):
    """Whatever is being loaded, compiled, thrown away or waited for."""
    scans = TINY / "scans" / "sequences" / "00"
    run = ["run", str(scans), "--bundle", str(BUNDLE), "--threads", "1", "--out", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-c", AT, file, name, str(again), *run], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.stdout == "now\n", "there was no such moment"
    assert done.returncode == 130
    assert "mos: interrupted" in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr


def test_an_interrupt_while_a_kernel_is_compiled():
    """It is compiled to its end: half of it would leave the compiler closed."""

    @kernel
    def added(a, b):
        return a + b

    cache_of(added).flush()  # of a test before
    with on_compile(lambda _: interrupt()), pytest.raises(KeyboardInterrupt):
        added(1, 2)
    assert len(added.signatures) == 1
    assert added(1, 2) == 3
