"""Poses `T_world_lidar`: checking, and the way from KITTI's camera frame to the LiDAR's."""

import numpy as np
import numpy.typing as npt

from runtime.errors import PoseError

# Largest entry of R R^T - I, and of |det R - 1|, up to which a rotation is taken as it is, and up to which the nearest
# one is taken in its place: rounding to three decimals costs at most 2.6e-3.
RIGID_TOLERANCE = 1e-3
ROUNDED_TOLERANCE = 3e-3

FARTHEST = 1e9  # m from the origin: no map goes so far, and squares of what does would overflow

Pose = npt.NDArray[np.float64]  # (4, 4)
Poses = npt.NDArray[np.float64]  # (T, 4, 4)


def camera_to_lidar(poses: Poses, tr: Pose) -> Poses:
    """KITTI camera poses (T, 4, 4) to T_world_lidar (T, 4, 4), the world being the LiDAR frame of the first pose.

    inv(Tr) @ inv(P_0) @ P_t @ Tr with tr = T_camera_lidar, and P_0 the first pose that is rigid. Raises PoseError where
    there is none.
    """
    skew, determinant = _deviation(poses)
    rigid = np.maximum(skew, abs(determinant - 1)) <= ROUNDED_TOLERANCE  # NaN is not
    to_lidar = np.linalg.inv(tr) @ np.linalg.inv(check_pose(poses[np.argmax(rigid)], "first pose"))
    with np.errstate(invalid="ignore", over="ignore"):  # later poses are checked one by one
        moved: Poses = to_lidar @ poses @ tr
    return moved


def check_pose(pose: npt.ArrayLike, where: str = "pose") -> Pose:
    """`pose` as (4, 4) float64; a rotation of few decimals as the nearest rotation, a good one bit for bit as it is.

    Raises PoseError, beginning with `where`, unless it is rigid and finite.
    """
    try:
        matrix = np.asarray(pose, np.float64)
    except (TypeError, ValueError) as error:
        raise PoseError(f"{where}: a pose is a (4, 4) matrix of numbers, not {type(pose).__name__}") from error
    if matrix.shape != (4, 4):
        raise PoseError(f"{where}: a pose is a (4, 4) matrix T_world_lidar, not of shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise PoseError(f"{where}: holds NaN or infinity; leave such scans out or repair their poses")
    if np.abs(matrix[:3, 3]).max() > FARTHEST:
        raise PoseError(f"{where}: lies {np.abs(matrix[:3, 3]).max():.3g} m from the origin, farther than any map")
    if not np.allclose(matrix[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise PoseError(f"{where}: the last row must be 0 0 0 1, not {matrix[3]}; is the matrix transposed?")
    skew, determinant = _deviation(matrix)
    if not max(skew, abs(determinant - 1)) <= ROUNDED_TOLERANCE:
        raise PoseError(
            f"{where}: is not a rigid transform (R R^T differs from 1 by {skew:.2g}, det R is "
            f"{determinant:.4g}); its rotation must be orthonormal and right-handed, without scale"
        )
    return with_nearest_rotations(matrix)


def are_good(poses: Poses) -> npt.NDArray[np.bool_]:
    """Which of poses (T, 4, 4) `check_pose` takes bit for bit as they are: all at once."""
    with np.errstate(invalid="ignore"):
        placed = (np.abs(poses[:, :3, 3]) <= FARTHEST).all(1) & (poses[:, 3] == [0, 0, 0, 1]).all(1)
    skew, determinant = _deviation(poses)
    good: npt.NDArray[np.bool_] = placed & (np.maximum(skew, abs(determinant - 1)) <= RIGID_TOLERANCE)
    return good


def with_nearest_rotations(poses: Poses) -> Poses:
    """Poses (..., 4, 4) with the nearest orthonormal matrix where a rotation has few decimals; the others stay.

    Returns `poses` itself where there is none of that kind.
    """
    skew, determinant = _deviation(poses)
    off = np.maximum(skew, abs(determinant - 1))
    rounded = (off > RIGID_TOLERANCE) & (off <= ROUNDED_TOLERANCE)
    if not rounded.any():
        return poses
    u, _, vt = np.linalg.svd(poses[rounded, :3, :3])
    repaired = poses.copy()
    repaired[rounded, :3, :3] = u @ vt
    return repaired


def _deviation(poses: Poses) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Of poses (..., 4, 4): largest entry of R R^T - I, and det R."""
    rotation = poses[..., :3, :3]
    with np.errstate(all="ignore"):
        skew = np.abs(rotation @ rotation.swapaxes(-1, -2) - np.eye(3)).max((-2, -1))
        return skew, np.linalg.det(rotation)


def relative_pose(target: Pose, source: Pose) -> Pose:
    """T_target_source (4, 4) of the poses T_world_target and T_world_source.

    Only the difference of the two positions is taken, in float64, so map coordinates of 5e6 m cost no precision.
    """
    back = target[:3, :3].T
    transform = np.eye(4)
    transform[:3, :3] = back @ source[:3, :3]
    transform[:3, 3] = back @ (source[:3, 3] - target[:3, 3])
    return transform
