"""Float or 8-bit integers: what a machine gains from."""

import ctypes
import platform
import sys
from collections.abc import Collection, Sequence
from pathlib import Path

from llvmlite import binding

from runtime.bundle.manifest import IMAGE_NET, IMAGE_NET_INT8, Bundle
from runtime.errors import SettingError

PRECISIONS = ("auto", "float32", "int8")
# Names as LLVM has them, which it does not tell of ARM: there the system does. With VNNI or ARM's dot product an
# instruction multiplies and sums bytes; with AVX2 two do, whose 16-bit sums hold what a bundle's 7-bit kernels give.
QUICK = {"avx512vnni": "AVX-512 VNNI", "avxvnni": "AVX VNNI", "i8mm": "I8MM", "dotprod": "dot product", "avx2": "AVX2"}
LINUX_NAMES = {"asimddp": "dotprod", "i8mm": "i8mm"}  # in /proc/cpuinfo
MAC_NAMES = {b"hw.optional.arm.FEAT_DotProd": "dotprod", b"hw.optional.arm.FEAT_I8MM": "i8mm"}  # of sysctl
WINDOWS_NUMBERS = {43: "dotprod"}  # of IsProcessorFeaturePresent


def choose_precision(
    bundle: Bundle, wanted: str, providers: Sequence[str], features: Collection[str] | None = None
) -> tuple[str, str]:
    """The precision of the image network, "float32" or "int8", and why.

    wanted: "float32", "int8" or "auto". providers: names of the execution providers asked for, none for the CPU.
    features: of the processor, by LLVM's names; None: this one's. Raises SettingError for another precision.
    """
    if wanted not in PRECISIONS:
        raise SettingError(f"precision must be one of {', '.join(PRECISIONS)}, not {wanted!r}")
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


def processor_features() -> set[str]:
    """What this processor has, by LLVM's names: all that LLVM knows, and of ARM what `QUICK` asks for."""
    found = {name for name, there in binding.get_host_cpu_features().items() if there}
    if platform.machine().lower() in ("aarch64", "arm64"):
        found |= arm_features()
    return found


def arm_features(cpuinfo: Path = Path("/proc/cpuinfo")) -> set[str]:
    """Dot product and I8MM, where Linux, macOS or Windows says that this processor has them."""
    if sys.platform == "win32":
        present = ctypes.windll.kernel32.IsProcessorFeaturePresent
        return {name for number, name in WINDOWS_NUMBERS.items() if present(number)}
    if sys.platform == "darwin":
        return {name for key, name in MAC_NAMES.items() if _sysctl(key)}
    try:
        words = set(cpuinfo.read_text().split())
    except OSError:
        return set()
    return {name for word, name in LINUX_NAMES.items() if word in words}


def _sysctl(key: bytes) -> int:
    """A number that macOS keeps under `key`; 0 where it has none."""
    value = ctypes.c_int(0)
    size = ctypes.c_size_t(ctypes.sizeof(value))
    failed = ctypes.CDLL(None).sysctlbyname(key, ctypes.byref(value), ctypes.byref(size), None, ctypes.c_size_t(0))
    return 0 if failed else value.value
