"""What comes on topics to which anybody may publish."""

from runtime.errors import ScanError
from runtime.live.joining import careful


def test_a_message_that_is_broken_ends_nothing(caplog):
    taken = []

    def take(data):
        if data == b"broken":
            raise ScanError("cannot be read as TF")
        taken.append(data)

    heard = careful("/tf", take)
    for data in (b"broken", b"1", b"broken", b"2"):
        heard(data)
    assert taken == [b"1", b"2"]
    assert caplog.text.count("left out") == caplog.text.count("of /tf: cannot be read as TF") == 1
