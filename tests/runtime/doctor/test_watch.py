"""What `MosRunner` warns of, and what it does not."""

import warnings

import numpy as np
import pytest

from bench.corruption import HARMLESS, WRONG, scaled
from bench.scans import load_frames
from runtime import MosRunner, MosWarning
from runtime.errors import MosError
from tests.support import street
from tests.support.paths import BUNDLE, KITTI, SHARED

PANDASET = SHARED / "data" / "pandaset" / "sequences" / "002"
LISTED = (
    "remission times 255",
    "remission NaN",
    "millimetres",
    "centimetres",
    "10 degrees down",
    "upside down",
    "5 columns read as 4",
    "identity poses",
    "relative poses",
    "poses at half scale",
)
# what a short drive through flat boxes cannot show: turns are small, and it goes on as it began
UNSEEN = (
    "poses turned by 10 degrees on the sensor",
    "poses frozen after 5",
    "transposed rotations",
    "no rotations",
    "scans in the world's axes",
)

TURNED_BACK = "10 degrees down"


@pytest.fixture(scope="module")
def drive():
    """22 scans of a street."""
    world = street.boxes()
    return [(street.scan(pose, world), pose) for pose in street.drive(22)]


@pytest.fixture(scope="module")
def runner():
    with MosRunner(BUNDLE, threads=1, postprocess="none") as made:
        yield made


@pytest.fixture(scope="module")
def default():
    with MosRunner(threads=1, postprocess="none") as made:
        yield made


def said(runner, frames):
    """Scans, from 0, at which something is said, and what; an error ends it."""
    runner.reset()
    found = []
    for number, frame in enumerate(frames):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                runner(*frame)
            except MosError as error:
                return [*found, (number, str(error))]
        assert all(one.category is MosWarning and one.filename == __file__ for one in caught)
        found += [(number, str(one.message)) for one in caught]
    return found


@pytest.mark.parametrize("name", [name for name in WRONG if name not in UNSEEN])
def test_a_street_that_is_wrong(runner, drive, name):
    found = said(runner, WRONG[name](drive))
    assert found
    assert found[0][0] < 20


@pytest.mark.parametrize("name", HARMLESS)
def test_a_street_that_is_right(runner, drive, name):
    assert said(runner, HARMLESS[name](drive)) == []


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the KITTI scans in ../shared")
@pytest.mark.parametrize("name", [name for name in LISTED if name != TURNED_BACK])
def test_a_real_drive_that_is_wrong(default, name):
    assert said(default, WRONG[name](load_frames(KITTI / "90", 20)))


@pytest.mark.skipif(not KITTI.is_dir(), reason="needs the KITTI scans in ../shared")
def test_a_real_drive_that_is_tilted_is_turned_back(default):
    """Where the sensor is found in the scans, so is the frame that they come in: nothing is wrong any more."""
    frames = load_frames(KITTI / "90", 12)
    assert said(default, WRONG[TURNED_BACK](frames)) == []
    default.reset()
    tilted = [default(*frame) for frame in WRONG[TURNED_BACK](frames)][-1]
    default.reset()
    level = [default(*frame) for frame in frames][-1]
    assert (tilted.moving == level.moving).mean() > 0.99


@pytest.mark.parametrize("folder", [KITTI / "90", KITTI / "00", PANDASET], ids=lambda folder: folder.name)
def test_a_real_drive_that_is_right(default, folder):
    if not folder.is_dir():
        pytest.skip("needs the scans in ../shared")
    assert said(default, load_frames(folder, 100)) == []


def test_each_topic_once_until_reset(runner, drive):
    frames = WRONG["remission times 255"](WRONG["poses at half scale"](drive))
    first = [text.split(":")[0] for _, text in said(runner, [*frames, *frames[::-1]])]
    assert sorted(first) == ["alignment", "remission"]
    assert len(said(runner, frames)) == 2


def test_where_warnings_are_errors_the_state_stays_as_it_was(drive):
    frames = scaled(poses=0.5)(drive)
    with (
        MosRunner(BUNDLE, threads=1, postprocess="none") as plain,
        MosRunner(BUNDLE, threads=1, postprocess="none") as strict,
    ):
        number, text = said(plain, frames)[0]
        for frame in frames[:number]:
            strict(*frame)
        for _ in range(2):
            with pytest.raises(MosWarning, match="surroundings"):
                strict(*frames[number])
        plain.reset()
        for frame in frames[:number]:
            plain(*frame)
        for runner in (plain, strict):
            with pytest.warns(MosWarning) as caught:
                runner(*frames[number])
            assert [str(one.message) for one in caught] == [text]
        for frame in frames[number + 1 :]:
            np.testing.assert_array_equal(strict(*frame).probability, plain(*frame).probability)


def test_a_call_that_fails_counts_for_nothing(runner, drive):
    frames = WRONG["remission times 255"](drive)
    number = said(runner, frames)[0][0]
    runner.reset()
    for frame in frames[:number]:
        with pytest.raises(MosError):
            runner(frame[0], np.zeros((4, 4)))
        runner(*frame)
    with pytest.warns(MosWarning, match="remission"):
        runner(*frames[number])


ODD = {
    "empty": lambda scan: scan[:0],
    "one point": lambda scan: scan[:1],
    "not finite": lambda scan: np.full_like(scan, np.nan),
    "far away": lambda scan: scan * np.float32(1000),
    "a thousandth": lambda scan: scan * np.float32(0.001),
    "without remission": lambda scan: scan[:, :3],
}


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("numbers", [(0, 18), (6,)])
def test_no_odd_scan_decides(runner, drive, odd, numbers):
    """Scans 0, 6, 12 and 18 are looked at."""
    frames = [(ODD[odd](scan) if i in numbers else scan, pose) for i, (scan, pose) in enumerate(drive)]
    assert said(runner, frames) == []
