from runtime.live.newest import Newest


def test_only_the_newest_counts():
    newest = Newest[int]()
    assert newest.take(0.0) is None
    for item in range(3):
        newest.put(item)
    assert newest.take(0.0) == 2
    assert newest.take(0.0) is None
    assert (newest.came, newest.dropped) == (3, 2)
    newest.put(3)
    assert newest.restart() == 3  # the one that waits is of what was before
    assert (newest.take(0.0), newest.dropped) == (None, 0)
