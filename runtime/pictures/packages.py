"""Packages that only pictures need."""

from importlib.util import find_spec

from runtime.errors import MissingPackageError

PILLOW, RERUN = "PIL", "rerun"
_NAMES = {PILLOW: "Pillow", RERUN: "rerun-sdk"}  # as pip knows them


def has_package(package: str) -> bool:
    """Whether PILLOW or RERUN is installed."""
    return find_spec(package) is not None


def need_package(package: str, what: str) -> None:
    """Raises MissingPackageError, naming the extra, where `what` cannot be made."""
    if not has_package(package):
        raise MissingPackageError(
            f"{what} needs {_NAMES[package]}, not installed here: pip install 'lidar-mos[view]' (or {_NAMES[package]})"
        )
