"""A number for the content of a scan, so cheap that every scan of a run has one."""

import hashlib

import numpy as np
import numpy.typing as npt

BLOCK = 8192  # 32-bit words that are summed up together
# Fixed random 64-bit weights. A sum of words times such weights, modulo 2^64, tells any two blocks apart but for one
# case in 2^32 (multilinear hashing; Lemire and Kaser, "Strongly universal string hashing is fast", 2014).
WEIGHTS = np.frombuffer(hashlib.shake_128(b"weights of the fingerprint").digest(8 * BLOCK), "<u8")


def fingerprint_of(
    data: npt.NDArray[np.float32],
    pose: npt.NDArray[np.float64] | None,
    time: float | None,
    times: npt.NDArray[np.float32] | None = None,
) -> str:
    """Of a scan (N, 3 or 4) with its pose (4, 4), its time in s, and those of its points (N,): 16 hexadecimal digits.

    Takes 0.3 ms for 2 MB, where the hashes of `hashlib` take 1.2 to 4: the blocks are summed up, and only their sums
    and the rest go into one of those.
    """
    digest = hashlib.blake2b(repr((data.shape, time)).encode(), digest_size=8)
    for array in (data,) if times is None else (data, times):
        words = np.ascontiguousarray(array, "<f4").view("<u4").reshape(-1)
        whole = len(words) // BLOCK * BLOCK
        sums = np.einsum("ij,j->i", words[:whole].reshape(-1, BLOCK), WEIGHTS, dtype=np.uint64, casting="unsafe")
        digest.update(sums.tobytes())
        digest.update(words[whole:].tobytes())
    if pose is not None:
        digest.update(pose.astype("<f8").tobytes())
    return digest.hexdigest()
