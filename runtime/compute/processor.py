"""What the instructions of this processor can do."""

import ctypes
import platform
import sys
from pathlib import Path

from llvmlite import binding

LINUX_NAMES = {"asimddp": "dotprod", "i8mm": "i8mm"}  # in /proc/cpuinfo
MAC_NAMES = {b"hw.optional.arm.FEAT_DotProd": "dotprod", b"hw.optional.arm.FEAT_I8MM": "i8mm"}  # of sysctl
WINDOWS_NUMBERS = {43: "dotprod"}  # of IsProcessorFeaturePresent


def processor_features() -> set[str]:
    """What this processor has, by LLVM's names. Of ARM, LLVM tells nothing: there the system does, of some."""
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
