"""Moving-object segmentation of LiDAR scans on a plain CPU.

from runtime import MosRunner

runner = MosRunner()
for scan, pose in stream:  # (N, 4) float32 x y z remission; (4, 4) T_world_lidar
    result = runner(scan, pose)  # result.moving (N,) bool, .probability (N,) float32
"""

from typing import TYPE_CHECKING, Any

from runtime.errors import MosError, MosWarning

if TYPE_CHECKING:
    from runtime.belief.result import MosResult
    from runtime.runner import MosRunner

__all__ = ["MosError", "MosResult", "MosRunner", "MosWarning", "__version__"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """`MosRunner` and `MosResult` load Numba and ONNX Runtime, so only when they are asked for."""
    if name in ("MosRunner", "MosResult"):
        from runtime import runner

        return getattr(runner, name)
    raise AttributeError(f"module 'runtime' has no attribute {name!r}")
