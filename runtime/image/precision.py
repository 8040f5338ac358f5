"""Float or 8-bit integers: what a machine gains from."""

from collections.abc import Collection, Sequence

from runtime.bundle.loading import Bundle
from runtime.bundle.manifest import IMAGE_NET, IMAGE_NET_INT8
from runtime.compute.processor import processor_features
from runtime.errors import SettingError
from runtime.settings import CHOICES

# By LLVM's names. With VNNI or ARM's dot product an instruction multiplies and sums bytes; with AVX2 two do, whose
# 16-bit sums hold what a bundle's 7-bit kernels give.
QUICK = {"avx512vnni": "AVX-512 VNNI", "avxvnni": "AVX VNNI", "i8mm": "I8MM", "dotprod": "dot product", "avx2": "AVX2"}


def choose_precision(
    bundle: Bundle, wanted: str, providers: Sequence[str], features: Collection[str] | None = None
) -> tuple[str, str]:
    """The precision of the image network, "float32" or "int8", and why.

    wanted: "float32", "int8" or "auto". providers: names of the execution providers asked for, none for the CPU.
    features: of the processor, by LLVM's names; None: this one's. Raises SettingError for another precision.
    """
    if wanted not in CHOICES["precision"]:
        raise SettingError(f"precision must be one of {', '.join(CHOICES['precision'])}, not {wanted!r}")
    if wanted != "auto":
        return wanted, "as asked for"
    if IMAGE_NET_INT8 not in bundle.manifest.files:
        return "float32", "the bundle has no other"
    if IMAGE_NET not in bundle.manifest.files:
        return "int8", "the bundle has no other"
    if others := [name for name in providers if name != "CPUExecutionProvider"]:
        return "float32", f"8-bit integers are for the processor, not for {others[0]}"
    features = processor_features() if features is None else features
    for key, name in QUICK.items():
        if key in features:
            return "int8", f"the processor has {name}"
    return "float32", f"the processor has none of {', '.join(QUICK.values())}, so that 8-bit integers gain nothing"
