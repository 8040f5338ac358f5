"""Packages that not everyone needs, and the extras that bring them."""

from importlib.util import find_spec

from runtime.errors import MissingPackageError

PILLOW, RERUN, LASPY, LAZRS, LZF, PYARROW, ROSBAGS = "PIL", "rerun", "laspy", "lazrs", "lzf", "pyarrow", "rosbags"
OUSTER, VELODYNE = "ouster", "velodyne_decoder"
KISS_ICP, CYCLONEDDS, RAY, S3FS = "kiss_icp", "cyclonedds", "ray", "s3fs"
_BROUGHT = {  # as pip knows them, and by which extra
    PILLOW: ("Pillow", "view"),
    RERUN: ("rerun-sdk", "view"),
    LASPY: ("laspy", "points"),
    LAZRS: ("lazrs", "points"),
    LZF: ("python-neo-lzf", "points"),
    PYARROW: ("pyarrow", "argoverse"),
    ROSBAGS: ("rosbags", "ros"),
    OUSTER: ("ouster-sdk", "ouster"),
    VELODYNE: ("velodyne-decoder", "velodyne"),
    KISS_ICP: ("kiss-icp", "odometry"),
    RAY: ("ray", "fleet"),
    S3FS: ("s3fs", "s3"),
    CYCLONEDDS: ("cyclonedds", "live"),
}


def has_package(package: str) -> bool:
    """Whether one of the packages above is installed."""
    return find_spec(package) is not None


def need_package(package: str, what: str) -> None:
    """Raises MissingPackageError, naming the extra, where `what` cannot be had."""
    if not has_package(package):
        name, extra = _BROUGHT[package]
        raise MissingPackageError(
            f"{what} needs {name}, not installed here: pip install 'lidar-mos[{extra}]' (or {name})"
        )
