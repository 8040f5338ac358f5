"""Names in files of strangers move no cursor and change no colours."""

import json
import os
import shutil

import pytest

from runtime.bundle.manifest import MANIFEST
from runtime.commands.main import main
from tests.support.paths import TINY

EVIL = "\x1b]0;owned\x07\x1b[2J\u202e\x9b31m"


def manifest_of_evil(bundle):
    values = json.loads((bundle / MANIFEST).read_text())
    values["name"] = values["licence"] = values["network"] = values["sensors"][0]["name"] = EVIL
    values["weights"] |= {EVIL: EVIL, "source": [EVIL]}
    values["accuracy"] = {EVIL: {EVIL: EVIL}}
    values["model"] |= {EVIL: EVIL}
    (bundle / MANIFEST).write_text(json.dumps(values))


def check(capfd):
    said = "".join(capfd.readouterr())
    assert said
    assert all(character.isprintable() or character == "\n" for character in said)


def test_a_manifest(bundle, capfd):
    manifest_of_evil(bundle)
    assert main(["info", str(bundle)]) == 0
    check(capfd)
    values = json.loads((bundle / MANIFEST).read_text())
    (bundle / MANIFEST).write_text(json.dumps(values | {EVIL: 1}))
    assert main(["info", str(bundle)]) == 1
    check(capfd)


@pytest.mark.skipif(os.name != "posix", reason="needs such names")
def test_folders(tmp_path, bundle, capfd):
    folder = tmp_path / f"evil {EVIL}" / "sequences" / "00"
    shutil.copytree(TINY / "scans" / "sequences" / "00", folder)
    out = tmp_path / EVIL / "out"
    manifest_of_evil(bundle)
    moved = shutil.move(bundle, tmp_path / f"bundle {EVIL}")
    common = ["--bundle", str(moved), "--threads", "1", "--postprocess", "none", "--limit", "3"]
    assert main(["run", str(folder), "--out", str(out), *common]) == 0
    check(capfd)
    assert main(["run", str(folder), "--out", str(out), *common, "--nearest", "1"]) == 1
    check(capfd)
    assert main(["doctor", str(folder)]) in (0, 1)
    check(capfd)
    for wrong in (["info", str(tmp_path / EVIL)], ["run", str(tmp_path / EVIL / "none")], ["doctor", EVIL]):
        assert main(wrong) in (1, 2)
        check(capfd)


def test_what_is_logged(capfd, monkeypatch):
    """By the library, while a command runs: as lines of the command."""
    import logging

    from runtime.commands.handler import run_alone

    def work() -> None:
        logging.getLogger("lidar_mos").warning("%s is damaged", EVIL)
        logging.getLogger("lidar_mos.recordings").info("%s", EVIL)
        logging.getLogger("lidar_mos").info("not said")

    assert run_alone(work, "tool", []) == 0
    said = capfd.readouterr().err
    assert len(said.splitlines()) == 2
    assert said.count("tool: ") == 2
    assert all(character.isprintable() or character == "\n" for character in said)
