"""Which precision a runner takes: what the bundle has, what the processor gains from."""

import platform
import sys
from types import SimpleNamespace

import pytest

from runtime.errors import SettingError
from runtime.image.precision import arm_features, choose_precision, processor_features

FLOAT, INT8 = "image_net.onnx", "image_net_int8.onnx"


def bundle(*files):
    return SimpleNamespace(manifest=SimpleNamespace(files=dict.fromkeys(files)))


@pytest.mark.parametrize(
    ("files", "wanted", "providers", "features", "precision", "reason"),
    [
        ((FLOAT, INT8), "auto", [], {"avx512vnni", "avx2"}, "int8", "AVX-512 VNNI"),
        ((FLOAT, INT8), "auto", ["CPUExecutionProvider"], {"avxvnni"}, "int8", "AVX VNNI"),
        ((FLOAT, INT8), "auto", [], {"avx2"}, "int8", "AVX2"),
        ((FLOAT, INT8), "auto", [], {"dotprod"}, "int8", "dot product"),
        ((FLOAT, INT8), "auto", [], {"sse4.1"}, "float32", "gain nothing"),
        ((FLOAT, INT8), "auto", ["CUDAExecutionProvider"], {"avx2"}, "float32", "not for CUDA"),
        ((FLOAT,), "auto", [], {"avx512vnni"}, "float32", "no other"),
        ((INT8,), "auto", [], set(), "int8", "no other"),
        ((FLOAT, INT8), "int8", [], set(), "int8", "asked for"),
        ((FLOAT, INT8), "float32", [], {"avx512vnni"}, "float32", "asked for"),
    ],
)
def test_choice(files, wanted, providers, features, precision, reason):
    chosen, why = choose_precision(bundle(*files), wanted, providers, features)
    assert chosen == precision
    assert reason in why


def test_an_unknown_precision_is_an_error():
    with pytest.raises(SettingError, match="auto, float32, int8"):
        choose_precision(bundle(FLOAT), "float16", [])


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
