import numpy as np
import pytest

from runtime.recordings.fingerprint import BLOCK, fingerprint_of

POSE = np.eye(4)


def scan(points, columns=4):
    return np.random.default_rng(points).normal(size=(points, columns)).astype(np.float32)


@pytest.mark.parametrize("points", [0, 1, BLOCK // 4, BLOCK // 4 + 1, 30_000])
def test_every_bit_counts(points):
    data = scan(points)
    seen = {fingerprint_of(data, POSE, 0.5)}
    words = data.view(np.uint32).reshape(-1)
    for place in np.unique(np.linspace(0, len(words) - 1, 40).astype(int)) if points else ():
        for bit in (0, 7, 31):
            words[place] ^= np.uint32(1 << bit)
            seen.add(fingerprint_of(data, POSE, 0.5))
            words[place] ^= np.uint32(1 << bit)
    assert len(seen) == 1 + (3 * len(np.unique(np.linspace(0, len(words) - 1, 40).astype(int))) if points else 0)
    assert fingerprint_of(data, POSE, 0.5) in seen


def test_changes_that_tools_make():
    data = scan(50_000)
    changed = [
        data,
        data / 255,
        data * [1, -1, 1, 1],
        data * [1, 1, 1, 0],
        data[::-1],
        data[:-1],
        data[:, [1, 0, 2, 3]],
    ]
    changed += [data[:, :3], np.roll(data, 1, 0), np.vstack([data[BLOCK // 4 :], data[: BLOCK // 4]])]
    assert len({fingerprint_of(np.ascontiguousarray(one, np.float32), POSE, None) for one in changed}) == len(changed)


def test_pose_and_time_count():
    data, moved = scan(100), POSE.copy()
    moved[0, 3] = 1e-9
    found = [fingerprint_of(data, pose, time) for pose in (None, POSE, moved) for time in (None, 0.0, 1e-9)]
    times = np.zeros(100, np.float32)
    found += [fingerprint_of(data, None, None, one) for one in (times, times + np.float32(1e-9))]
    assert len(set(found)) == 11


def test_it_is_the_same_everywhere_and_always():
    data = np.arange(40_000, dtype=np.float32).reshape(-1, 4)
    assert fingerprint_of(data, POSE, 0.5) == "232d748ae9f328c2"
