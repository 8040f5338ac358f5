"""What the processor has."""

import platform
import sys

import pytest

from runtime.compute.processor import arm_features, processor_features


@pytest.mark.skipif(sys.platform != "linux", reason="reads what Linux writes")
def test_arm_processors_say_what_they_have(tmp_path):
    text = "processor\t: 0\nFeatures\t: fp asimd evtstrm {} crc32\nCPU implementer\t: 0x41\n"
    info = tmp_path / "cpuinfo"
    for words, features in (("asimddp i8mm", {"dotprod", "i8mm"}), ("asimddp", {"dotprod"}), ("asimdhp", set())):
        info.write_text(text.format(words))
        assert arm_features(info) == features
    assert arm_features(tmp_path / "none") == set()


@pytest.mark.skipif(platform.machine() != "x86_64", reason="every x86-64 processor has SSE2")
def test_this_processor():
    assert "sse2" in processor_features()
