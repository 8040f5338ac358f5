"""`mos live` beside a system that runs in another process: the real DDS on this machine, in a domain of its own."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from runtime import MosRunner
from runtime.recordings.recording import Scan
from tests.support import street
from tests.support.paths import BUNDLE, ROOT

pytest.importorskip("cyclonedds", reason="the extra `live` is not installed")

from tests.support import ros_system  # which needs it

COUNT = 25
MOUNT = np.eye(4)
MOUNT[:3, 3] = 0.3, 0.0, 1.2
LONGEST = 180.0  # s, for a process that hangs


@pytest.fixture
def domain():
    return 100 + os.getpid() % 100


@pytest.fixture
def start(domain):
    """`start(module, arguments)`: a process in the domain."""
    started = []
    env = {**os.environ, "CYCLONEDDS_URI": ros_system.ALONE, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"}

    def call(module, *arguments):
        command = [sys.executable, "-m", module, *map(str, arguments)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        started.append(subprocess.Popen(command, cwd=ROOT, env=env, **pipes))
        return started[-1]

    yield call
    for one in started:
        if one.poll() is None:
            one.kill()
        one.communicate()


@pytest.fixture(scope="module")
def drive():
    """Scans (N, 4) and poses T_odom_lidar."""
    poses, world = street.drive(COUNT, step=0.4), street.boxes()
    return [street.scan(pose, world, rows=16, columns=180) for pose in poses], poses


def replayed(drive, folder, start, domain, poses, *options):
    """What was answered to a drive, and the two texts of `mos live`."""
    scans, truth = drive
    np.savez(folder / "drive.npz", poses=truth, mount=MOUNT, **{f"scan_{i}": scan for i, scan in enumerate(scans)})
    live = start("runtime.commands.start", "live", "--bundle", BUNDLE, "--threads", 1, *options)
    system = start("tests.support.ros_system", folder / "drive.npz", folder / "answers.npz", domain, poses)
    _, errors = system.communicate(timeout=LONGEST)
    if system.returncode:
        live.send_signal(signal.SIGINT)
        raise AssertionError(errors + "".join(live.communicate(timeout=LONGEST)))
    live.send_signal(signal.SIGINT)
    shown, said = live.communicate(timeout=LONGEST)
    assert live.returncode == 0, said
    return dict(np.load(folder / "answers.npz")), shown, said


def numbered(answers, name):
    """Which scan each answer is to, by the stamps."""
    count = sum(key.startswith(f"{name}_") and key.endswith("_stamp") for key in answers)
    return [int(np.argmin(abs(answers["stamps"] - answers[f"{name}_{i}_stamp"]))) for i in range(count)]


@pytest.mark.filterwarnings("ignore:the time steps by")  # while the first scan was prepared, or this machine was busy
@pytest.mark.parametrize("poses", ["tf", "odometry"])
def test_clouds_come_back_labelled(drive, tmp_path, start, domain, poses):
    """With the labels that the runner gives to the same scans and poses; what was dropped, it never saw."""
    named = ["--pose-topic", "/odom"] if poses == "odometry" else []
    answers, shown, said = replayed(drive, tmp_path, start, domain, poses, "--topic", "/points", *named)
    order = numbered(answers, "labelled")
    assert order == sorted(set(order)), said
    assert order[0] == 0
    assert order == numbered(answers, "static")
    assert f"{len(order)} scans; {COUNT - len(order)} dropped; from stamp to publication" in shown
    with MosRunner(BUNDLE, threads=1) as runner:
        for answer, index in enumerate(order):
            scan = drive[0][index]
            result = runner(Scan(f"{index}", scan, time=float(answers["stamps"][index])), drive[1][index])
            got = {name: answers[f"labelled_{answer}_{name}"] for name in ("x", "y", "z", "intensity", "moving")}
            for column, name in enumerate(("x", "y", "z", "intensity")):
                np.testing.assert_array_equal(got[name], scan[:, column])
                np.testing.assert_array_equal(answers[f"static_{answer}_{name}"], scan[~result.moving, column])
            np.testing.assert_array_equal(got["moving"], result.moving)
            np.testing.assert_allclose(answers[f"labelled_{answer}_probability"], result.probability, atol=1e-3)
    where = "TF from odom to lidar" if poses == "tf" else "/odom, of base_link"
    assert f"the poses are those of {where}" in said


def test_poses_are_found_where_none_come(drive, tmp_path, start, domain):
    pytest.importorskip("kiss_icp")
    answers, _, said = replayed(drive, tmp_path, start, domain, "none", "--odometry", "kiss")
    assert numbered(answers, "labelled")[0] == 0, said
    assert "/points is there, best effort" in said
    assert "Traceback" not in said


def test_what_is_missing_is_said(start, domain, monkeypatch):
    """Nobody publishes the topic, and then somebody does, of another type."""
    live = start("runtime.commands.start", "live", "--bundle", BUNDLE, "--topic", "points", "--threads", 1)
    line = ""
    while "nobody publishes /points yet (--domain); there is no topic at all" not in line:
        line = live.stderr.readline()
        assert live.poll() is None
    live.send_signal(signal.SIGTERM)
    shown, said = live.communicate(timeout=LONGEST)
    assert (live.returncode, shown) == (0, "0 scans; 0 dropped\n")
    wrong = start("runtime.commands.start", "live", "--bundle", BUNDLE, "--topic", "/odom", "--threads", 1)
    monkeypatch.setenv("CYCLONEDDS_URI", ros_system.ALONE)
    system = ros_system.System(domain)
    shown, said = wrong.communicate(timeout=LONGEST)
    assert wrong.returncode == 1
    assert "/odom (--topic) is of nav_msgs/msg/Odometry, not of sensor_msgs/msg/PointCloud2" in said
    del system


def test_poses_that_are_needed_and_do_not_come(drive, start, domain, monkeypatch):
    live = start("runtime.commands.start", "live", "--bundle", BUNDLE, "--odometry", "none", "--threads", 1)
    monkeypatch.setenv("CYCLONEDDS_URI", ros_system.ALONE)
    system = ros_system.System(domain)
    system.tf_static.write(ros_system.transforms(MOUNT, 0.0, "base_link", "lidar"))
    while live.poll() is None:
        system.clouds.write(ros_system.cloud(drive[0][0], time.time()))
        time.sleep(0.1)
    _, said = live.communicate(timeout=LONGEST)
    assert live.returncode == 1
    assert "no poses: TF: lidar ends at base_link, and nothing moves up to there" in said
    assert "(--odometry kiss)" in said
