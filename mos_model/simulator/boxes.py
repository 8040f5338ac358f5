"""Boxes around primitives. The kinds are part of the format that `raycast` describes: they never change."""

import numpy as np

from mos_model.simulator.raycast import ELLIPSOID, FRUSTUM
from runtime.compute.jit import kernel


@kernel
def bounds(prims):  # type: ignore[no-untyped-def]
    """Boxes around the primitives in their own frames, (n, 6): x, y, z least and greatest."""
    out = np.empty((len(prims), 6))
    for k in range(len(prims)):
        g = prims[k, 6:14]
        if prims[k, 0] == FRUSTUM:
            out[k, 0], out[k, 3] = min(g[2], g[4]), max(g[3], g[5])
            out[k, 4] = max(g[6], g[7])
            out[k, 1] = -out[k, 4]
            out[k, 2], out[k, 5] = g[0], g[1]
        elif prims[k, 0] == ELLIPSOID:
            for a in range(3):
                out[k, a], out[k, 3 + a] = g[a] - g[3 + a], g[a] + g[3 + a]
        else:
            for a in range(3):
                out[k, a], out[k, 3 + a] = min(g[a], g[3 + a]) - g[6], max(g[a], g[3 + a]) + g[6]
    return out
