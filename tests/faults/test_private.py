"""Offline and private: nothing is asked of the network, and nothing written that nobody asked for."""

import json
import os
import subprocess
import sys

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


def watched(commands, tmp_path, **variables):
    home = tmp_path / "home"
    home.mkdir()
    environment = {k: v for k, v in os.environ.items() if k != "ORT_DISABLE_TELEMETRY"}
    environment |= {"HOME": str(home), "XDG_CONFIG_HOME": str(home), "XDG_CACHE_HOME": str(home), **variables}
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
