"""Which precision a runner takes: what the bundle has, what the processor gains from."""

from types import SimpleNamespace

import pytest

from runtime.errors import SettingError
from runtime.image.precision import choose_precision

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
