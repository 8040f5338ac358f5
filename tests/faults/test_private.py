"""Offline and private: nothing is asked of the network, and nothing written that nobody asked for."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from importlib.util import find_spec

import pytest

from tests.support.paths import BUNDLE, ROOT, TINY

WATCHED = """
import json, os, sys
seen = []
def watch(event, arguments):
    if event.startswith("socket.") and event != "socket.__new__":
        seen.append([event, repr(arguments)])
        raise OSError("the network is not there")
    if event == "open" and isinstance(arguments[0], (str, bytes)) and isinstance(arguments[2], int):
        if arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            seen.append(["write", os.fsdecode(arguments[0])])
sys.addaudithook(watch)
from runtime.commands.main import main
codes = [main(arguments) for arguments in json.loads(sys.argv[1])]
print(json.dumps([codes, seen, os.environ.get("ORT_DISABLE_TELEMETRY")]))
"""


@pytest.fixture
def commands(tmp_path):
    scans, out = str(TINY / "scans" / "sequences" / "00"), str(tmp_path / "out")
    common = ["--bundle", str(BUNDLE), "--threads", "1"]
    return [
        ["info", str(BUNDLE)],
        ["run", scans, "--out", out, "--limit", "3", *common],
        ["doctor", scans, "--bundle", str(BUNDLE)],
        ["--version"],
    ]


def at_home(home, **variables):
    """An environment with a home folder that is empty."""
    home.mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    return environment | {"HOME": str(home), "XDG_CONFIG_HOME": str(home), "XDG_CACHE_HOME": str(home), **variables}


def watched(commands, tmp_path, **variables):
    home = tmp_path / "home"
    environment = at_home(home, **variables)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", WATCHED, json.dumps(commands)],
        env=environment, cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return *json.loads(done.stdout.splitlines()[-1]), sorted(path.name for path in home.rglob("*"))


def test_no_network_and_no_file_that_nobody_asked_for(commands, tmp_path):
    codes, seen, telemetry, home = watched(commands, tmp_path)
    assert codes == [0, 0, codes[2], 0]
    assert codes[2] in (0, 1)
    assert [event for event in seen if event[0] != "write"] == []
    allowed = (str(tmp_path / "out"), os.devnull, "/dev/tty")
    written = [path for what, path in seen if what == "write" and not path.startswith(allowed)]
    assert [path for path in written if "__pycache__" not in path] == []
    assert home == []
    assert telemetry == "1"


def test_who_wants_telemetry_has_it(tmp_path):
    *_, telemetry, _ = watched([["info", str(BUNDLE)]], tmp_path, ORT_DISABLE_TELEMETRY="0")
    assert telemetry == "0"


# With what is not Python: ONNX Runtime, KISS-ICP, Rerun, Cyclone DDS. `strace` sees all that a process asks of Linux
STRACE = ["strace", "-D", "-f", "-qq", "-e", "trace=connect,sendto,sendmsg,sendmmsg,openat,open,creat", "-o"]
ASKED = re.compile(r"sa_family=AF_INET6?[,}]|\"(/[^\"]+)\", [A-Z_|]*(?:O_WRONLY|O_RDWR|O_CREAT)")
KITTI = TINY / "scans" / "sequences" / "00"


def can_trace():
    return shutil.which("strace") and subprocess.run(["strace", "-qq", "-o", os.devnull, "true"]).returncode == 0


def asked(trace):
    """Addresses (as the whole line) and files to be written, but for those that were not there."""
    lines = [line for line in trace.read_text(errors="replace").splitlines() if "= -1 ENOENT" not in line]
    return {found[1] or line for line in lines if (found := ASKED.search(line))}


def library(name):
    """Skips where it is not installed."""
    return pytest.param(name, marks=pytest.mark.skipif(find_spec(name) is None, reason=f"needs {name}"))


COMMANDS = {
    "onnxruntime": ["run", KITTI, "--limit", "3", "--threads", "2", "--out", "out"],
    "kiss_icp": ["run", KITTI, "--limit", "3", "--odometry", "kiss", "--out", "out"],
    "rerun": ["view", KITTI, "--count", "2", "--out", "out/drive.rrd"],
    "cyclonedds": ["live", "--topic", "points", "--threads", "1"],
}
NEAR = ("127.0.0.1", "239.255.0.1")  # where Cyclone DDS looks for others, on this machine alone
ALONE = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces></General></Domain>"
    "</CycloneDDS>"
)


@pytest.mark.skipif(not can_trace(), reason="needs strace, and to be allowed to")
@pytest.mark.parametrize("below", [library(name) for name in COMMANDS])
def test_no_library_below_either(below, tmp_path):
    home, out, trace = tmp_path / "home", tmp_path / "out", tmp_path / "trace"
    out.mkdir()
    environment = at_home(home, CYCLONEDDS_URI=ALONE, ROS_DOMAIN_ID="213", PYTHONPATH=str(ROOT))
    command = [sys.executable, "-m", "runtime.commands.start", *map(str, COMMANDS[below]), "--bundle", str(BUNDLE)]
    with subprocess.Popen(
        [*STRACE, str(trace), *command], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True
    ) as process:
        said = ""
        for line in process.stderr:
            said += line
            if "nobody publishes" in line:  # it would wait for ever
                process.send_signal(signal.SIGTERM)
    assert process.returncode == 0, said
    wanted = (str(out), os.devnull, "/dev/tty", "/dev/shm", "/proc/self/")
    found = {one for one in asked(trace) if not one.startswith(wanted) and "__pycache__" not in one}
    assert {one for one in found if below != "cyclonedds" or not any(address in one for address in NEAR)} == set()
    assert list(home.rglob("*")) == []
