"""`mos run --write bag`: a bag in, a bag out, whose points say whether they move."""

import numpy as np
import pytest

from runtime.classes import MOVING, to_classes
from runtime.commands.main import main
from runtime.recordings.labels import read_prediction
from tests.support import street
from tests.support.bag_writers import KINDS, BagWriter, messages
from tests.support.disk import full_disk
from tests.support.paths import BUNDLE

pytest.importorskip("rosbags")
COUNT = 4


@pytest.fixture(params=KINDS)
def bag(request, tmp_path):
    """Clouds of one frame, its odometry, and a topic that nobody asks for."""
    poses, world = street.drive(COUNT), street.boxes()
    path = tmp_path / ("log.bag" if request.param == "bag" else "log")
    with BagWriter(path, request.param) as writer:
        for index, pose in enumerate(poses):
            writer.pose(pose, 0.1 * index)
            writer.cloud(street.scan(pose, world, rows=16, columns=90), 0.1 * index)
            writer.cloud(np.ones((5, 4), np.float32), 0.1 * index, topic="/rear")
    return path


def run(bag, *options):
    given = ["--topic", "/points", "--pose-topic", "/odom", "--bundle", str(BUNDLE), "--threads", "1"]
    return main(["run", str(bag), "--out", str(bag.parent / "out"), "--write", "bag", *given, *options])


def clouds(path):
    """Fields (N,) of each cloud of /points, by rosbags alone."""
    from rosbags.highlevel import AnyReader

    kinds = {2: "u1", 7: "<f4"}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages([one for one in reader.connections if one.topic == "/points"]):
            message = reader.deserialize(data, connection.msgtype)
            record = np.dtype(
                {
                    "names": [one.name for one in message.fields],
                    "formats": [kinds[one.datatype] for one in message.fields],
                    "offsets": [one.offset for one in message.fields],
                    "itemsize": message.point_step,
                }
            )
            yield np.frombuffer(message.data.tobytes(), record)


def test_there_and_back(bag, capsys):
    assert run(bag) == 0
    sequence = bag.parent / "out" / "sequences" / bag.stem
    copy = sequence / "bag" / bag.name
    assert f"bag with labels: {copy}, {COUNT} clouds" in capsys.readouterr().out
    before, after = messages(bag), messages(copy)
    assert before.keys() == after.keys()
    for key in before:
        assert [time for time, _ in after[key]] == [time for time, _ in before[key]]
        assert key[0] == "/points" or after[key] == before[key]
    for index, (was, now) in enumerate(zip(clouds(bag), clouds(copy), strict=True)):
        for name in was.dtype.names:
            np.testing.assert_array_equal(now[name], was[name])
        labels = to_classes(read_prediction(sequence / "predictions" / f"{index:06d}.label"))
        np.testing.assert_array_equal(now["moving"], labels == MOVING)
        np.testing.assert_array_equal(now["probability"], np.load(sequence / "probabilities" / f"{index:06d}.npy"))
        assert now["probability"].max() > 0
    # what is gone is made again, and a copy that is labelled is not labelled twice
    (sequence / "probabilities" / "000002.npy").unlink()
    assert run(bag) == 0
    assert f"sequence {bag.stem}: 1 scans, 3 were there already" in capsys.readouterr().out
    assert messages(copy) == after
    assert run(copy) == 1
    assert "its clouds have a field probability already" in capsys.readouterr().err


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # rosbags 0.9 leaves its file open
def test_a_full_disk_leaves_no_bag_that_is_cut(bag, capsys):
    with full_disk(20_000):  # labels fit, the bag does not
        assert run(bag) == 1
    sequence = bag.parent / "out" / "sequences" / bag.stem
    assert "cannot write" in capsys.readouterr().err
    assert len(list((sequence / "predictions").glob("*.label"))) == COUNT
    assert [path.name for path in sequence.iterdir() if "bag" in path.name] == []
    assert run(bag) == 0
    whole = messages(sequence / "bag" / bag.name)
    assert [len(some) for (topic, _, _), some in whole.items() if topic == "/points"] == [COUNT]
    with full_disk(20_000):
        assert run(bag) == 1
    assert messages(sequence / "bag" / bag.name) == whole


def test_what_is_no_bag(tmp_path, capsys):
    folder = street.write_kitti(tmp_path / "07", 2, rows=16, columns=90)
    assert main(["run", str(folder), "--bundle", str(BUNDLE), "--out", str(tmp_path / "out"), "--write", "bag"]) == 1
    assert "is no bag; labels go into clouds of their own (--write cloud)" in capsys.readouterr().err
    assert not list((tmp_path / "out").rglob("*.label"))
