"""Rotations in three ways: matrices, quaternions x y z w, and turns: the axis, as long as the angle in rad.

Diebel, *Representing Attitude*, Stanford University, 2006; quaternions of matrices after Shepperd, *Quaternion from
Rotation Matrix*, Journal of Guidance and Control 1(3), 1978.
"""

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]


def matrices_of_quaternions(quaternions: Numbers) -> Numbers:
    """(..., 3, 3) of quaternions (..., 4) of any length; of zeros they are NaN."""
    largest = np.abs(quaternions).max(axis=-1, keepdims=True)
    quaternions = np.ldexp(quaternions, -np.frexp(largest)[1])  # exact, and their squares neither overflow nor vanish
    with np.errstate(invalid="ignore"):
        x, y, z, w = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def quaternions_of_matrices(matrices: Numbers) -> Numbers:
    """(..., 4) of unit length, w not negative, of rotations (..., 3, 3)."""
    m = np.moveaxis(np.asarray(matrices), (-2, -1), (0, 1))
    squares = np.stack(  # four times x², y², z², w²; the largest one divides
        [
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
            1 + m[0, 0] + m[1, 1] + m[2, 2],
        ],
        -1,
    )
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    xw, yw, zw = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    products = np.stack(  # four times the products of each of them with all
        [
            np.stack([squares[..., 0], xy, xz, xw], -1),
            np.stack([xy, squares[..., 1], yz, yw], -1),
            np.stack([xz, yz, squares[..., 2], zw], -1),
            np.stack([xw, yw, zw, squares[..., 3]], -1),
        ],
        -2,
    )
    row = np.take_along_axis(products, squares.argmax(-1)[..., None, None], -2)[..., 0, :]
    row = row * np.where(row[..., 3:] < 0, -1.0, 1.0)
    found: Numbers = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return found


def turns_of_matrices(matrices: Numbers) -> Numbers:
    """(..., 3) rad, at most pi long, of rotations (..., 3, 3)."""
    quaternions = quaternions_of_matrices(matrices)
    sine, cosine = np.linalg.norm(quaternions[..., :3], axis=-1, keepdims=True), quaternions[..., 3:]
    small = sine < 1e-12
    found: Numbers = quaternions[..., :3] * np.where(
        small, 2.0, 2 * np.arctan2(sine, cosine) / np.where(small, 1, sine)
    )
    return found


def matrices_of_turns(turns: Numbers) -> Numbers:
    """(..., 3, 3) of turns (..., 3) rad."""
    half = np.linalg.norm(turns, axis=-1, keepdims=True) / 2
    axis = np.asarray(turns) / 2 * np.sinc(half / np.pi)  # sin(half) of the axis, at no turn too
    return matrices_of_quaternions(np.concatenate([axis, np.cos(half)], -1))
