"""The ground: grids of heights and surface classes painted from the roads; rays that end on it. Kernels."""

import numpy as np

from runtime.compute.jit import fast_kernel, inlined, kernel

ROAD, MARKING, SIDEWALK, TERRAIN, PAVED = 0, 1, 2, 3, 4  # surface classes of a cell
COARSE = 1.0  # m, cell of the grid of distances to the next road


@kernel
def paint_roads(edge, x0, y0, cell, segments, reach):  # type: ignore[no-untyped-def]
    """Lower `edge` (rows, columns), the distance of each node to the nearest road's edge (negative on the
    road), by `segments` (n, 5): two end points and the half width of the road there, all in m. Nodes beyond
    `reach` stay."""
    rows, columns = edge.shape
    for k in range(segments.shape[0]):
        ax, ay, bx, by, half = segments[k]
        far = reach + half
        i0 = max(0, int((min(ay, by) - far - y0) / cell))
        i1 = min(rows, int((max(ay, by) + far - y0) / cell) + 2)
        j0 = max(0, int((min(ax, bx) - far - x0) / cell))
        j1 = min(columns, int((max(ax, bx) + far - x0) / cell) + 2)
        ux, uy = bx - ax, by - ay
        square = max(ux * ux + uy * uy, 1e-9)
        for i in range(i0, i1):
            for j in range(j0, j1):
                px, py = x0 + j * cell - ax, y0 + i * cell - ay
                w = min(max((px * ux + py * uy) / square, 0.0), 1.0)
                d = np.sqrt((px - w * ux) ** 2 + (py - w * uy) ** 2) - half
                if d < edge[i, j]:
                    edge[i, j] = d


@kernel
def bilinear(grid, x0, y0, cell, x, y):  # type: ignore[no-untyped-def]
    """Value of `grid` at (x, y), clamped to its border."""
    gx, gy = (x - x0) / cell, (y - y0) / cell
    gx = min(max(gx, 0.0), grid.shape[1] - 1.001)
    gy = min(max(gy, 0.0), grid.shape[0] - 1.001)
    j, i = int(gx), int(gy)
    fx, fy = gx - j, gy - i
    low = grid[i, j] * (1.0 - fx) + grid[i, j + 1] * fx
    high = grid[i + 1, j] * (1.0 - fx) + grid[i + 1, j + 1] * fx
    return low * (1.0 - fy) + high * fy


@kernel
def bilinear_many(grid, x0, y0, cell, x, y):  # type: ignore[no-untyped-def]
    """Values of `grid` at the points (x, y), (n,)."""
    out = np.empty(len(x))
    for k in range(len(x)):
        out[k] = bilinear(grid, x0, y0, cell, x[k], y[k])
    return out


@fast_kernel
def pave(height, surface, cell, edge, base, style):  # type: ignore[no-untyped-def]
    """Fill the fine grids `height` (float32 m) and `surface` (uint8 class) from the coarse grids `edge` and
    `base`.

    `style`: sidewalk width, kerb height, width of the strip beyond it at the same height, slope and largest
    height of the bank beyond, surface class of the strip, surface class beyond, half width of the middle
    marking (0: none).
    """
    walk, kerb, strip, bank, bank_top, strip_class, far_class, marking = style
    rows, columns = height.shape
    edges, bases = np.empty(edge.shape[1]), np.empty(edge.shape[1])
    step = cell / COARSE
    for i in range(rows):
        low = min(int(i * step), edge.shape[0] - 2)
        f = i * step - low
        for j in range(edge.shape[1]):
            edges[j] = edge[low, j] + f * (edge[low + 1, j] - edge[low, j])
            bases[j] = base[low, j] + f * (base[low + 1, j] - base[low, j])
        for j in range(columns):
            low = min(int(j * step), edge.shape[1] - 2)
            f = j * step - low
            e = edges[low] + f * (edges[low + 1] - edges[low])
            h = bases[low] + f * (bases[low + 1] - bases[low])
            if e < 0.0:
                surface[i, j] = ROAD
                h += 0.02 * min(-e, 4.0)  # the road's crown, towards the middle
                if -0.35 < e < -0.2 and marking > 0.0:
                    surface[i, j] = MARKING
            else:
                h += kerb * min(e / 0.12, 1.0)
                if e < walk:
                    surface[i, j] = SIDEWALK
                elif e < walk + strip:
                    surface[i, j] = np.uint8(strip_class)
                else:
                    surface[i, j] = np.uint8(far_class)
                    rise = bank * (e - walk - strip)
                    h += min(max(rise, -bank_top), bank_top)
            height[i, j] = h


@inlined
def _height(grid, gx, gy):  # type: ignore[no-untyped-def]
    """Bilinear value of `grid` at (gx, gy) in cells; beyond its border its slope goes on."""
    j, i = min(max(int(gx), 0), grid.shape[1] - 2), min(max(int(gy), 0), grid.shape[0] - 2)
    fx, fy = gx - j, gy - i
    low = grid[i, j] + fx * (grid[i, j + 1] - grid[i, j])
    high = grid[i + 1, j] + fx * (grid[i + 1, j + 1] - grid[i + 1, j])
    return low + fy * (high - low)


@fast_kernel
def cast_ground(  # type: ignore[no-untyped-def]
    world, slope, origin, level, drop, height, surface, x0, y0, cell, highest, radii, rough, seed, depth, hit
):
    """First crossing of every ray with the ground: `depth` (columns, beams) m along the ray (inf: none) and
    `hit`, -2 - surface class. `drop` (beams,) lowers each beam's origin; `highest` m is the top of the
    ground; `radii` (n,) m are the places where it is looked up along a column; `rough` (5,) m is what grows
    or lies on each surface."""
    columns, beams = depth.shape
    count = len(radii)
    profile = np.empty(count)
    state = np.uint64(seed) | np.uint64(1)
    scale = 1.0 / cell
    ux, uy, known = 1.0, 0.0, 0
    for c in range(columns):
        ox, oy, oz = (origin[c, 0] - x0) * scale, (origin[c, 1] - y0) * scale, origin[c, 2]
        k = 0
        if c % 2 == 0:  # two columns share the profile of one
            ux, uy, known = level[c, 0] * scale, level[c, 1] * scale, 0
        for b in range(beams - 1, -1, -1):  # a higher ray of the same column crosses the ground later
            depth[c, b] = np.inf
            hit[c, b] = -1
            s = slope[c, b]
            z = oz - drop[b]
            end = radii[count - 1]
            if s * end > highest - z and s > 0.0:
                end = (highest - z) / s  # from there on above all ground
            if b < beams - 1 and drop[b] > drop[b + 1]:
                k = 0
            found = False
            while k < count and radii[k] <= end:
                if k == known:
                    profile[k] = _height(height, ox + ux * radii[k], oy + uy * radii[k])
                    known = k + 1
                if profile[k] >= z + s * radii[k]:
                    found = True
                    break
                k += 1
            if not found or k == 0:
                continue
            last, gap = radii[k - 1], radii[k] - radii[k - 1]
            before = profile[k - 1] - z - s * last
            climb = profile[k] - profile[k - 1] - s * gap
            rho = last + gap * min(max(-before / (climb + 1e-12), 0.0), 1.0)
            dx, dy, dz = world[c, b, 0] * scale, world[c, b, 1] * scale, world[c, b, 2]
            stretch = np.sqrt(1.0 + s * s)  # of the ray over its shadow
            t = rho * stretch
            # One Newton step along the true ray, which may stand a little beside its column.
            fix = (z + dz * t - _height(height, ox + dx * t, oy + dy * t)) * gap / min(-climb, -0.01 * gap)
            t -= min(max(fix, -gap), gap) * stretch
            j = min(max(int(ox + dx * t + 0.5), 0), height.shape[1] - 1)
            i = min(max(int(oy + dy * t + 0.5), 0), height.shape[0] - 1)
            kind = surface[i, j]
            if rough[kind] > 0.0:
                state ^= state << np.uint64(13)
                state ^= state >> np.uint64(7)
                state ^= state << np.uint64(17)
                u = np.int64(state >> np.uint64(40)) * (1.0 / 16777216.0)
                key = np.uint64(i * 73856093 ^ j * 19349663) * np.uint64(0x9E3779B97F4A7C15)
                fixed = np.int64(key >> np.uint64(40)) * (1.0 / 16777216.0)
                grass = rough[kind] * (0.6 * fixed * fixed + 0.4 * u * u)
                t -= min(grass / max(-dz, 0.02), 0.06 * t)
            depth[c, b] = t
            hit[c, b] = -2 - np.int32(kind)
