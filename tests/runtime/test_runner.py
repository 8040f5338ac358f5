"""The contract of MosRunner, on the tiny bundle."""

import os
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from runtime import MosRunner, MosWarning
from runtime.compute.sessions import available_providers
from runtime.errors import BundleError, InferenceError, PoseError, ProviderError, ScanError, SettingError
from runtime.settings import RunnerSettings
from tests.support import street
from tests.support.paths import BUNDLE, ROOT


def drive(count: int, seed: int = 0, points: int = 2000) -> list[tuple[np.ndarray, np.ndarray]]:
    """Scans of a room that the sensor drives through, with a box that moves."""
    rng = np.random.default_rng(seed)
    frames = []
    for t in range(count):
        angle = rng.uniform(-np.pi, np.pi, points)
        wall = np.stack([20 * np.cos(angle), 10 * np.sin(angle), rng.uniform(-1.5, 1, points)], 1)
        wall[:, 0] -= 0.5 * t
        box = rng.uniform(-1, 1, (200, 3)) * (2, 1, 0.8) + (8 + 0.7 * t, 3, 0)
        xyz = np.concatenate([wall, box])
        scan = np.concatenate([xyz, rng.uniform(0, 1, (len(xyz), 1))], 1).astype(np.float32)
        pose = np.eye(4)
        pose[0, 3] = 0.5 * t
        frames.append((scan, pose))
    return frames


@pytest.fixture(scope="module")
def runner():
    return MosRunner(BUNDLE, threads=2)


def run(runner, frames):
    runner.reset()
    return [runner(*frame) for frame in frames]


@pytest.mark.parametrize("postprocess", ["none", "knn", "head"])
@pytest.mark.parametrize("refine", ["near", "all"])
def test_a_label_for_every_point(postprocess, refine):
    results = run(MosRunner(BUNDLE, threads=2, postprocess=postprocess, refine=refine), drive(10))
    for result in results:
        assert result.moving.shape == result.probability.shape == (2200,)
        assert result.moving.dtype == np.bool_
        assert result.probability.dtype == np.float32
        assert ((result.probability >= 0) & (result.probability <= 1)).all()
        assert set(result.timing) == {"input", "network", "postprocess", "belief", "history", "total"}
    assert [result.ready for result in results] == [False] * 8 + [True] * 2


def test_threads_and_repetition_change_nothing(runner):
    frames = drive(10)
    want = run(runner, frames)
    for other in (runner, MosRunner(BUNDLE, threads=1)):
        for a, b in zip(want, run(other, frames), strict=True):
            np.testing.assert_array_equal(a.moving, b.moving)
            np.testing.assert_allclose(a.probability, b.probability, atol=1e-6)


def test_results_and_inputs_stay_as_they_are(runner):
    frames = drive(4)
    copies = [(scan.copy(), pose.copy()) for scan, pose in frames]
    for scan, pose in frames:
        scan.setflags(write=False)
        pose.setflags(write=False)
    results = run(runner, frames)
    first = results[0].probability.copy()
    run(runner, drive(3, seed=9))
    np.testing.assert_array_equal(results[0].probability, first)
    for (scan, pose), (scan_before, pose_before) in zip(frames, copies, strict=True):
        np.testing.assert_array_equal(scan, scan_before)
        np.testing.assert_array_equal(pose, pose_before)


def test_scan_is_copied_into_the_history(runner):
    frames = drive(9)
    want = run(runner, frames)[-1].probability
    runner.reset()
    buffer = np.empty_like(frames[0][0])
    for scan, pose in frames:
        buffer[:] = scan
        got = runner(buffer, pose).probability
        buffer[:] = -1
    np.testing.assert_array_equal(got, want)


def test_points_without_place(runner):
    frames = drive(9)
    scan = frames[-1][0].copy()
    scan[3, :3] = 0
    scan[5, 0] = np.nan
    scan[6, 2] = np.inf
    scan[8, 0] = 3e5  # 300 km away, beyond the sensor's reach
    scan[9, 1] = -1e30
    nowhere = [3, 5, 6, 8, 9]
    result = run(runner, [*frames[:-1], (scan, frames[-1][1])])[-1]
    assert not result.moving[nowhere].any()
    assert (result.probability[nowhere] == 0).all()
    assert np.isfinite(result.probability).all()
    rest = np.delete(scan, nowhere, axis=0)
    without = run(runner, [*frames[:-1], (rest, frames[-1][1])])[-1]
    np.testing.assert_array_equal(np.delete(result.probability, nowhere), without.probability)


def test_a_senseless_return_raises_nothing_where_something_may_move():
    """The point head has to look at every point: what may move beside a return 300 km away."""
    from runtime.bundle.manifest import Tuned

    frames = drive(9)
    scan = frames[-1][0].copy()
    scan[7, :3] = 3e5, 0, 0
    with MosRunner(BUNDLE, threads=1, postprocess="head") as runner:
        runner._stages.refiner._tuned = Tuned(candidate=0.0)
        result = run(runner, [*frames[:-1], (scan, frames[-1][1])])[-1]
    assert result.probability[7] == 0
    assert not result.moving[7]
    assert result.probability.any()


def test_remission_that_is_not_finite_is_missing_and_the_point_stays(runner):
    frames = drive(9)
    scan, filled = frames[-1][0].copy(), frames[-1][0].copy()
    scan[4:40:3, 3] = np.nan, *[np.inf, -np.inf, np.nan] * 3, np.nan, np.inf
    filled[4:40:3, 3] = runner.bundle.manifest.sensor.range_image.mean[4]
    got, want = (run(runner, [*frames[:-1], (one, frames[-1][1])])[-1] for one in (scan, filled))
    np.testing.assert_array_equal(got.probability, want.probability)
    assert want.probability[4:40:3].all()


def test_a_closed_runner_says_so():
    frames = drive(2)
    with MosRunner(BUNDLE, threads=2) as runner:
        runner(*frames[0])
    for call in (runner, runner.remember):
        with pytest.raises(InferenceError, match="closed"):
            call(*frames[1])


def test_settings_are_one_object_and_unknown_ones_are_refused():
    settings = RunnerSettings(threads=1, refine="all")
    with MosRunner(BUNDLE, settings=settings, postprocess="knn") as runner:
        assert runner.settings == RunnerSettings(threads=1, refine="all", postprocess="knn")
        assert (runner.postprocess, runner.workers.threads) == ("knn", 1)
    with pytest.raises(SettingError, match="no setting thread; there are threads, postprocess"):
        MosRunner(BUNDLE, thread=1)


def test_places_do_not_depend_on_bad_points_before(runner):
    """Bad points enter no history."""
    frames = drive(9)
    want = run(runner, frames)[-1].probability
    bad = np.full((50, 4), np.nan, np.float32)
    bad[::2] = 0
    bad[1::4] = 4, 3e5, 0, 0.5
    worse = [(np.concatenate([scan, bad]), pose) for scan, pose in frames[:-1]]
    np.testing.assert_array_equal(run(runner, [*worse, frames[-1]])[-1].probability, want)


@pytest.mark.parametrize("time", ["now", float("nan"), object(), 10**400])
def test_a_time_that_is_none_is_refused_at_once(runner, time):
    runner.reset()
    scan, pose = drive(1)[0]
    for call in (runner, runner.remember):
        with pytest.raises(SettingError, match="seconds"):
            call(scan, pose, time)
    runner(scan, pose, np.float64(3))
    runner(scan, pose, np.int64(3) + 0.1)


def test_where_warnings_are_errors_a_jump_leaves_the_history(runner):
    frames = drive(10)
    want = run(runner, frames)[-1].probability
    run(runner, frames[:9])
    far = np.eye(4)
    far[0, 3] = 500
    with pytest.raises(MosWarning, match="jumps"):
        runner(frames[9][0], far)
    np.testing.assert_array_equal(runner(*frames[9]).probability, want)


def street_poses(reading):
    """Poses of 20 scans of a street, read rightly or wrongly."""
    poses = street.drive(20)
    if reading == "camera":
        return street.TR @ poses @ np.linalg.inv(street.TR)
    return poses if reading == "right" else np.tile(np.eye(4), (20, 1, 1))


@pytest.mark.parametrize("reading", ["right", "camera", "none"])
def test_poses_under_which_the_surroundings_move_are_doubted_once(runner, reading):
    world = street.boxes()
    scans = [street.scan(pose, world) for pose in street.drive(20)]
    runner.reset()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for scan, pose in zip(scans, street_poses(reading), strict=True):
            runner(scan, pose)
    doubts = [w for w in caught if issubclass(w.category, MosWarning) and "surroundings" in str(w.message)]
    assert len(doubts) == (reading != "right")
    assert len(doubts) == len(caught)
    assert all(w.filename == __file__ for w in caught)


def test_every_kernel_is_compiled_at_the_start():
    code = f"""
from runtime import MosRunner
from runtime.belief import believers, free_space, memory, objects, places
from runtime.image import decision
from runtime.image import history
from runtime.head.sparse import kernel_map
from runtime.image import vote as knn
from runtime.image import projection
from runtime.head.sparse import kernel as sparse_kernel
from runtime.head import transfer
from runtime.head import voxels
import numpy as np
runner = MosRunner({str(BUNDLE)!r}, postprocess="head", threads=1, belief="online")
modules = believers, free_space, memory, objects, places, decision, history, kernel_map, projection
modules += sparse_kernel, transfer, voxels
kernels = [k for m in modules for k in vars(m).values() if hasattr(k, "signatures") and k.__module__ == m.__name__]
before = [len(kernel.signatures) for kernel in kernels]
runner._stages.refiner.head.config  # there is one
wall = np.stack(np.broadcast_arrays(10.0, np.linspace(-9, 9, 400), 0.1, 0.5), 1).astype(np.float32)
from runtime.bundle.manifest import Tuned
runner._stages.refiner._tuned = Tuned(candidate=0.0)
runner(wall, np.eye(4))
late = [kernel.__name__ for kernel, n in zip(kernels, before) if len(kernel.signatures) != n]
assert not late, late
assert sum(before) > 20
"""
    done = in_fresh_process(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("scan", [np.empty((0, 4), np.float32), np.full((3, 4), np.nan, np.float32), np.zeros((1, 4))])
def test_nothing_to_see(runner, scan):
    runner.reset()
    result = runner(scan, np.eye(4))
    assert result.moving.shape == (len(scan),)
    assert not result.moving.any()
    assert (result.probability == 0).all()


def test_one_point_and_many(runner):
    runner.reset()
    assert runner(np.array([[5, 0, 0, 0]], np.float32), np.eye(4)).moving.shape == (1,)
    big = np.random.default_rng(0).uniform(-50, 50, (500_000, 4)).astype(np.float32)
    assert runner(big, np.eye(4)).moving.shape == (500_000,)


def test_without_remission_is_mean_remission(runner):
    frames = drive(3)
    mean = runner.bundle.manifest.sensor.range_image.mean[4]
    filled = []
    for scan, pose in frames:
        scan = scan.copy()
        scan[:, 3] = mean
        filled.append((scan, pose))
    want = run(runner, filled)[-1]
    got = run(runner, [(scan[:, :3].astype(np.float64), pose) for scan, pose in frames])[-1]
    np.testing.assert_array_equal(got.probability, want.probability)


@pytest.mark.parametrize(
    ("scan", "pose", "error"),
    [
        (np.zeros((5, 2), np.float32), np.eye(4), ScanError),
        (np.zeros(5, np.float32), np.eye(4), ScanError),
        (np.zeros((5, 4), np.int32), np.eye(4), ScanError),
        ([["a"] * 4], np.eye(4), ScanError),
        (np.ones((5, 4), np.float32), np.eye(3), PoseError),
        (np.ones((5, 4), np.float32), np.full((4, 4), np.nan), PoseError),
        (np.ones((5, 4), np.float32), np.diag([1.0, 1, -1, 1]), PoseError),
        (np.ones((5, 4), np.float32), 2 * np.eye(4), PoseError),
        (np.ones((5, 4), np.float32), None, PoseError),
    ],
)
def test_refused_input_leaves_the_history(runner, scan, pose, error):
    frames = drive(10)
    want = run(runner, frames)[-1].probability
    run(runner, frames[:-1])
    with pytest.raises(error):
        runner(scan, pose)
    np.testing.assert_array_equal(runner(*frames[-1]).probability, want)


def test_failed_inference_leaves_the_history(runner, monkeypatch):
    frames = drive(10)
    want = run(runner, frames)[-1].probability
    run(runner, frames[:-1])
    monkeypatch.setattr(runner._stages.inputs, "_mean", np.full(5, -3e38, np.float32))  # which overflows in the network
    with pytest.raises(InferenceError, match="finite"), np.errstate(all="ignore"):
        runner(*frames[-1])
    monkeypatch.undo()
    np.testing.assert_array_equal(runner(*frames[-1]).probability, want)


def test_map_coordinates(runner):
    """Poses 5e6 m from the origin of the map give what poses near it give."""
    frames = drive(10)
    far = np.eye(4)
    far[:3, 3] = (5e6, -4e6, 300.0)
    want = run(runner, frames)[-1].probability
    got = run(runner, [(scan, far @ pose) for scan, pose in frames])[-1].probability
    np.testing.assert_allclose(got, want, atol=1e-3)
    assert (np.abs(got - want) > 1e-5).mean() < 0.01


@pytest.mark.parametrize("kind", ["place", "turn", "time"])
def test_jump_drops_the_history(runner, kind):
    frames = drive(9)
    runner.reset()
    for i, (scan, pose) in enumerate(frames[:-1]):
        runner(scan, pose, time=0.1 * i)
    scan, pose = frames[-1]
    pose, time = pose.copy(), 0.8
    if kind == "place":
        pose[1, 3] += 15
    elif kind == "turn":
        pose[:2, :2] = [[0, -1], [1, 0]]
    else:
        time = 5.0
    with pytest.warns(MosWarning, match=r"history .* dropped"):
        got = runner(scan, pose, time=time)
    assert not got.ready
    runner.reset()
    np.testing.assert_array_equal(got.probability, runner(scan, pose).probability)


def test_remember_goes_on_as_if_it_had_run(runner):
    frames = drive(12)
    want = run(runner, frames)[-1]
    runner.reset()
    for frame in frames[3:-1]:
        runner.remember(*frame)
    got = runner(*frames[-1])
    assert got.ready
    np.testing.assert_array_equal(got.probability, want.probability)


@pytest.mark.parametrize(
    ("settings", "error", "match"),
    [
        ({"threads": 0}, SettingError, "threads"),
        ({"threads": -3}, SettingError, "threads"),
        ({"postprocess": "crf"}, SettingError, "postprocess"),
        ({"refine": "some"}, SettingError, "refine"),
        ({"providers": ["NoSuchProvider"]}, ProviderError, "NoSuchProvider"),
        ({"providers": ["CUDAExecutionProvider"]}, ProviderError, "onnxruntime-gpu"),
        ({"providers": "CPUExecutionProvider"}, SettingError, "list of names"),
        ({"head_engine": "spconv", "postprocess": "none"}, SettingError, "auto, numba, onnx"),
        ({"precision": "int8"}, BundleError, "int8"),
        ({"bundle": "no/such/folder"}, BundleError, "no bundle"),
    ],
)
def test_bad_settings(settings, error, match):
    if set(settings.get("providers", ())) & set(available_providers()):
        pytest.skip("this ONNX Runtime has the provider")
    with pytest.raises(error, match=match):
        MosRunner(**{"bundle": BUNDLE, **settings})


def test_fallback_must_be_allowed():
    with pytest.warns(MosWarning, match="NoSuchProvider"):
        runner = MosRunner(BUNDLE, providers=["NoSuchProvider"], allow_fallback=True)
    assert len(runner(*drive(1)[0]).moving) == 2200


def test_session_options_reach_onnxruntime():
    MosRunner(BUNDLE, session_options={"session.intra_op.allow_spinning": "1"})
    with pytest.raises(SettingError, match="session option"):
        MosRunner(BUNDLE, session_options={"": "1"})


def test_two_runners_in_two_threads():
    frames = [drive(6, seed) for seed in (1, 2)]
    want = [[r.probability for r in run(MosRunner(BUNDLE, threads=2), f)] for f in frames]
    runners = [MosRunner(BUNDLE, threads=2) for _ in frames]
    with ThreadPoolExecutor(2) as pool:
        got = list(pool.map(lambda i: [r.probability for r in run(runners[i], frames[i])], range(2)))
    for a, b in zip(want, got, strict=True):
        for x, y in zip(a, b, strict=True):
            np.testing.assert_array_equal(x, y)


def test_one_runner_in_two_threads(runner):
    """Calls wait for each other."""
    runner.reset()
    frame = drive(1)[0]
    errors = []

    def call():
        try:
            for _ in range(3):
                runner(*frame)
        except Exception as error:
            errors.append(error)

    threads = [threading.Thread(target=call) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors


def in_fresh_process(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, **environment},
        cwd=ROOT,
    )


def test_no_torch_no_onnx():
    done = in_fresh_process(
        "import sys; from runtime import MosRunner; import runtime.commands.main\n"
        "assert MosRunner\n"
        "bad = {'torch', 'onnx', 'mos_model', 'export'} & set(sys.modules)\n"
        "assert not bad, bad"
    )
    assert done.returncode == 0, done.stderr


def test_numba_and_blas_settings_are_left_alone():
    """Also under Numba's `workqueue` layer, which ends the process when two threads use it at once."""
    done = in_fresh_process(
        "import os, threading, numba, numpy as np\n"
        "from tests.runtime.test_runner import BUNDLE, drive\n"
        "from runtime import MosRunner\n"
        "before = numba.get_num_threads(), dict(os.environ)\n"
        "runners = [MosRunner(BUNDLE, threads=2) for _ in range(2)]\n"
        "threads = [threading.Thread(target=lambda r=r: [r(*f) for f in drive(3)]) for r in runners]\n"
        "[t.start() for t in threads]; [t.join() for t in threads]\n"
        "assert before == (numba.get_num_threads(), dict(os.environ))\n",
        NUMBA_THREADING_LAYER="workqueue",
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_runner_made_in_a_forked_child():
    done = in_fresh_process(
        "import os, warnings\n"
        "warnings.simplefilter('ignore', DeprecationWarning)\n"
        "from tests.runtime.test_runner import BUNDLE, drive\n"
        "from runtime import MosRunner\n"
        "parent = MosRunner(BUNDLE, threads=2, postprocess='none'); parent(*drive(1)[0])\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    MosRunner(BUNDLE, threads=2)(*drive(1)[0]); os._exit(0)\n"
        "assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0\n"
        "parent(*drive(2)[1])\n"
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("refine", ["near", "all"])
def test_equal_to_pytorch_from_scan_to_points(refine):
    """Committed scans, through everything, against what the PyTorch network gave for the naive input."""
    from runtime.recordings.registry import open_recording

    runner = MosRunner(BUNDLE, threads=2, postprocess="head", refine=refine)
    for read in open_recording(BUNDLE.parent / "scans/sequences/00"):
        result = runner(read.data, read.pose)
    scan = read.data
    want = np.load(BUNDLE.parent / "expected.npy")
    assert result.ready
    assert (scan[want.sum(1) == 0, :3] == 0).all()  # the one point at the origin
    off = np.abs(result.probability - want[:, 2]) > 1e-4
    assert off.mean() < 1e-3  # a point on the edge of a cell may lie in the next one
    assert np.array_equal(result.moving[~off], want[~off].argmax(1) == 2)
