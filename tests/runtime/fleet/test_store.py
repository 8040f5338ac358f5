"""Recordings and labels in a store, which is moto's server: S3 as its own client speaks it."""

import re
import socket
import threading
from pathlib import Path

import pytest

from runtime.commands.main import main
from runtime.errors import SettingError
from runtime.fleet import store
from runtime.fleet.remote import Remote, name_of, place_of
from runtime.fleet.store import Store, find_places
from tests.runtime.fleet.conftest import COUNT, NAMES
from tests.support.paths import BUNDLE

pytest.importorskip("s3fs", reason="needs the extra 's3'")
moto = pytest.importorskip("moto.server", reason="needs moto[server]")
pytestmark = pytest.mark.filterwarnings("ignore")  # what those do

SECRET = "not-to-be-seen-anywhere"


@pytest.fixture(scope="module")
def server():
    running = moto.ThreadedMotoServer(port=0, verbose=False)
    running.start()
    yield running.get_host_and_port()
    running.stop()


@pytest.fixture
def bucket(server, drives, monkeypatch):
    """With three recordings in `logs`, beside what is none."""
    at(monkeypatch, *server)
    for name, value in (("ACCESS_KEY_ID", "mos"), ("SECRET_ACCESS_KEY", SECRET), ("DEFAULT_REGION", "us-east-1")):
        monkeypatch.setenv(f"AWS_{name}", value)
    files = fresh()
    if files.exists("bucket"):
        files.rm("bucket", recursive=True)
    files.mkdir("bucket")
    for name in NAMES:
        files.put(str(drives / name), f"bucket/logs/day/{name}", recursive=True)
    files.pipe_file("bucket/logs/notes.txt", b"nothing to label")
    return files


def fresh():
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    return s3fs.S3FileSystem(use_listings_cache=False)


def at(monkeypatch, host, port):
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    fresh()


def run(*arguments):
    return main(["run", *arguments, "--bundle", str(BUNDLE)])


def stored(files, folder="bucket/out"):
    """Labels by their path below the output."""
    found = files.find(folder)
    return {Path(key).relative_to(folder): files.cat_file(key) for key in found if key.endswith(".label")}


def test_from_the_store_and_back(bucket, plain, capsys, tmp_path, monkeypatch):
    """The bytes are those of files; the same command goes on, and labels a scan that has changed anew."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    command = ["s3://bucket/logs", "--out", "s3://bucket/out"]
    assert run(*command) == 0
    assert stored(bucket) == plain
    shown = capsys.readouterr()
    assert re.search(rf"^01 +{COUNT} +0 ", shown.out, re.MULTILINE)
    assert "predictions: s3://bucket/out" in shown.out
    note = bucket.cat_file("bucket/out/sequences/01/run.json").decode()
    assert '"source": "s3://bucket/logs/day/01"' in note

    changed = "bucket/logs/day/01/velodyne/000020.bin"
    good = bucket.cat_file(changed)
    bucket.pipe_file(changed, good[:-16])
    assert run(*command) == 0
    assert len(stored(bucket)) == len(plain)
    assert stored(bucket) != plain
    bucket.pipe_file(changed, good)
    bucket.rm("bucket/out/sequences/02/predictions/000007.label")
    assert run(*command, "--jobs", "2", "--piece", "15") == 0
    assert stored(bucket) == plain
    assert re.search(rf"^03 +{COUNT} +{COUNT} ", capsys.readouterr().out, re.MULTILINE)
    assert not [key for key in bucket.find("bucket/out") if "scans." in key and not key.endswith("/scans.jsonl")]
    assert not list(tmp_path.glob("lidar-mos-*"))  # what was brought here is gone


def test_patterns_and_what_is_not_there(bucket, capsys):
    assert [str(one) for one in find_places(["s3://bucket/logs/*/0[13]"])] == [
        "s3://bucket/logs/day/01",
        "s3://bucket/logs/day/03",
    ]
    bucket.pipe_file("bucket/logs/drive.bag", b"#ROSBAG V2.0\n")
    found = find_places(["s3://bucket/logs/"])
    assert [name_of(one) for one in found] == ["01", "02", "03", "drive"]
    assert found[-1] == Remote("s3://bucket/logs/drive.bag", is_file=True)
    for given, said in {
        "s3://bucket/absent": "s3://bucket/absent: does not exist",
        "s3://bucket/logs/*.osf": "nothing matches this pattern",
        "s3://nobucket/logs": "s3://nobucket/logs: does not exist",
        "s3://bucket/logs/day/0[12] s3://bucket/logs/day/01": "",
    }.items():
        code = run(*given.split(), "--out", "s3://bucket/none", "--limit", "1")
        assert (code, said in capsys.readouterr().err) == (0 if not said else 1, True)
    bucket.copy("bucket/logs/day/01/velodyne/000000.bin", "bucket/other/01/000000.bin")
    assert run("s3://bucket/logs", "s3://bucket/other", "--out", "s3://bucket/two") == 1
    assert "other/01 have one name" in capsys.readouterr().err
    assert not bucket.exists("bucket/two")


@pytest.mark.parametrize("given", ["s3://", "gs://bucket/logs", "http://host/x", "s3://key:word@bucket/logs"])
def test_addresses_that_cannot_be(given):
    with pytest.raises(SettingError, match=r"s3://") as caught:
        place_of(given)
    assert "word" not in str(caught.value) or "passwords" in str(caught.value)
    assert "key:" not in str(caught.value)


def test_what_leads_out_of_its_folder(bucket, tmp_path):
    bucket.pipe_file("bucket/logs/day/../../evil.bin", b"x")
    with pytest.raises(SettingError, match="would lead out"):
        Store().sizes(Remote("s3://bucket/logs").key)


def test_uploads_that_are_lost(bucket, server, drives, plain, tmp_path, monkeypatch, capsys):
    """Connections end in the middle of objects: those are sent again, and none is ever half there."""
    monkeypatch.setattr(store, "WAITS", (0.01,) * 3)
    with Unreliable(server, losses=12) as proxy:
        at(monkeypatch, *proxy.address)
        assert run(str(drives / "01"), "--out", "s3://bucket/out") == 0
        assert proxy.lost == 12
    at(monkeypatch, *server)
    mine = {path: data for path, data in plain.items() if "01" in path.parts}
    assert stored(bucket) == mine

    with Unreliable(server, losses=10**9) as proxy:
        at(monkeypatch, *proxy.address)
        assert run(str(drives / "02"), "--out", "s3://bucket/out") == 1
    shown = capsys.readouterr()
    assert re.search(r"^mos: 02: s3://bucket/out/sequences/02", shown.err, re.MULTILINE)
    assert SECRET not in shown.out + shown.err
    at(monkeypatch, *server)
    assert set(stored(bucket).values()) <= set(plain.values())
    assert run(str(drives / "02"), "--out", "s3://bucket/out") == 0
    assert len(stored(bucket)) == 2 * COUNT


def test_no_keys(server, bucket, monkeypatch, capsys, tmp_path):
    """Who may not is told so, once, and no key is shown."""
    monkeypatch.setattr(store, "WAITS", ())
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    fresh()
    assert run("s3://bucket/logs", "--out", "s3://bucket/out") == 1
    shown = capsys.readouterr()
    assert "mos: s3://bucket/logs: " in shown.err
    assert "Traceback" not in shown.err


class Unreliable:
    """A server before the server, which ends connections in the middle of the first objects that are sent to it."""

    def __init__(self, server, losses):
        self._server, self._losses, self.lost = server, losses, 0
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.address = self._socket.getsockname()
        self._lock = threading.Lock()

    def __enter__(self):
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_):
        self._socket.close()

    def _accept(self):
        while True:
            try:
                client, _ = self._socket.accept()
            except OSError:
                return
            there = socket.create_connection(self._server)
            threading.Thread(target=self._pass, args=(there, client), daemon=True).start()
            threading.Thread(target=self._pass, args=(client, there, True), daemon=True).start()

    def _pass(self, source, target, losing=False):
        try:
            while data := source.recv(1 << 16):
                if losing and data.startswith(b"PUT"):
                    with self._lock:
                        lose = self.lost < self._losses
                        self.lost += lose
                    if lose:
                        target.sendall(data[: len(data) // 2])
                        break
                target.sendall(data)
        except OSError:
            pass
        for one in (source, target):
            one.close()
