"""Whether a kernel map fits itself: the compiled code reads and writes wherever a map says."""

import numpy as np

from runtime.compute.arguments import need, need_below
from runtime.errors import ScanError
from runtime.head.sparse.kernel import UNIT
from runtime.head.sparse.kernel_map import KernelMap


def check_map(given: KernelMap) -> None:
    """Raises ScanError where a kernel map does not fit itself: it names rows that there are not, ..."""
    need(given.starts, "starts", (-(-given.count_out // given.tile) if given.tile > 0 else -1, None), np.int32)
    pairs = len(given.inputs)
    need(given.inputs, "inputs", (pairs,), np.int32)
    need(given.outputs, "outputs", (pairs,), np.int32)
    need_below(given.inputs, max(1, given.count_in), "inputs", lowest=0)
    need_below(given.outputs, given.tile + 1, "outputs", lowest=0)
    need_below(given.starts, pairs + 1, "starts", lowest=0)
    runs = np.diff(given.starts, axis=1)
    filled = (runs % UNIT == 0) & (runs != UNIT) & (runs >= 0)
    if not given.starts.shape[1] or not filled.all() or (pairs and not given.count_in):
        raise ScanError(f"runs of pairs must be filled up to multiples of {UNIT}, at least two, and have inputs")
    if not all(array.flags.c_contiguous for array in (given.starts, given.inputs, given.outputs)):
        raise ScanError("the arrays of a kernel map must be contiguous")
