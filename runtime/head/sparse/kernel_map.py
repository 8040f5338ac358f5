"""Which voxels meet in a sparse convolution: kernel maps of all strides, from one list of Morton keys.

A Morton key holds the path through an octree: `key >> 3` is the voxel of twice the stride, `key & 7` the
place in it. So the coarser voxels come from a single pass over the finer ones, children lie side by side,
and the neighbours of a voxel are found among the children of its parent's neighbours: no search, no hashing.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from runtime.compute.arena import Arena
from runtime.compute.jit import compiled, ir, kernel, types
from runtime.compute.workers import Workers
from runtime.head.sparse.kernel import UNIT

MAX_TILE = 512  # outputs of one tile: their accumulators stay in the L2 cache
MIN_TILE = 128  # fewer: the weights, read once per tile, cost more than the work
_GRAIN = 8192  # voxels per task


@dataclass(frozen=True)
class KernelMap:
    """Pairs (input row, output row) of a sparse convolution with K offsets, by tile of outputs and offset.

    Pairs `starts[t, k] : starts[t, k + 1]` belong to offset k of the outputs `t * tile ...`. Each such run is
    filled up to a multiple of UNIT, at least two, with pairs (0, tile), whose result is dropped.
    """

    inputs: NDArray[np.int32]  # (P,) row of the input
    outputs: NDArray[np.int32]  # (P,) row of the output within its tile
    starts: NDArray[np.int32]  # (tiles, K + 1)
    tile: int  # outputs per tile
    count_in: int  # rows of the input
    count_out: int  # rows of the output
    pairs: int  # without those that fill up


@dataclass(frozen=True)
class Scale:
    """The voxels of one stride. V voxels, F voxels of the next finer and C of the next coarser stride."""

    keys: NDArray[np.int64]  # (V,) Morton keys, rising
    starts: NDArray[np.int32]  # (V + 1,) children of voxel v: finer voxels starts[v] ... (empty for stride 1)
    child: NDArray[np.int32]  # (V + 1, 8) finer voxel in each octant, F: none (empty for stride 1)
    parent: NDArray[np.int32]  # (V,) coarser voxel (empty for the coarsest)


def build_scales(keys: NDArray[np.int64], depth: int, arena: Arena, name: str = "") -> list[Scale]:
    """Voxels of the strides 1, 2, 4, ... until only one is left, at least `depth` strides after the first.

    `keys` (V,) int64, V >= 1: rising Morton keys of stride 1.
    """
    sizes = np.zeros(22, np.int64)
    _count_scales(keys, sizes)
    last = max(depth, int(np.argmax(sizes == 1)))
    scales: list[Scale] = []
    starts, child = np.zeros(0, np.int32), np.zeros((0, 8), np.int32)
    for level in range(last + 1):
        count = int(sizes[min(level, 21)])
        parent = arena.take(f"{name}parent{level}", (count if level < last else 0,), np.int32)
        scales.append(Scale(keys, starts, child, parent))
        if level < last:
            coarse = int(sizes[min(level + 1, 21)])
            coarse_keys = arena.take(f"{name}keys{level + 1}", (coarse,), np.int64)
            starts = arena.take(f"{name}starts{level + 1}", (coarse + 1,), np.int32)
            child = arena.take(f"{name}child{level + 1}", (coarse + 1, 8), np.int32)
            child[coarse] = len(keys)
            _coarsen(keys, parent, coarse_keys, starts, child)
            keys = coarse_keys
    return scales


def neighbours(
    scales: list[Scale], down_to: int, arena: Arena, workers: Workers, name: str = ""
) -> list[NDArray[np.int32]]:
    """Neighbour tables of the scales `down_to` ... last; result[i] is scale i's (empty below `down_to`).

    A table is (V + 1, 27) int32: column (dx + 1) + 3 (dy + 1) + 9 (dz + 1) holds the row of the voxel at that
    offset, V where there is none. Row V, the missing voxel's, is all V.
    """
    last = len(scales) - 1
    tables = [np.zeros((0, 27), np.int32)] * len(scales)
    alone = np.full((2, 27), 1, np.int32)
    alone[0, 13] = 0
    tables[last] = alone
    for level in range(last - 1, down_to - 1, -1):
        fine, coarse = scales[level], scales[level + 1]
        table = arena.take(f"{name}neighbours{level}", (len(fine.keys) + 1, 27), np.int32)
        table[-1] = len(fine.keys)
        run = partial(_neighbours, fine.keys, fine.parent, coarse.child, tables[level + 1], table)
        workers.ranges(run, len(fine.keys), _GRAIN)
        tables[level] = table
    return tables


def tile_size(count: int, workers: Workers) -> int:
    """Outputs per tile: as many as the cache holds, fewer where the threads would get too few tiles."""
    return min(MAX_TILE, max(MIN_TILE, -(-count // (4 * workers.threads))))


def table_map(table: NDArray[np.int32], count_in: int, arena: Arena, workers: Workers, name: str) -> KernelMap:
    """Kernel map of a table (V + 1, K) whose row v names the inputs of output v, `count_in` for none."""
    count, offsets = len(table) - 1, table.shape[1]
    tile = tile_size(count, workers)
    tiles = -(-count // tile)
    starts = arena.take(f"{name}.starts", (tiles, offsets + 1), np.int32)
    masks = arena.take(f"{name}.masks", (count,), np.uint32)
    grain = max(1, _GRAIN // tile)
    workers.ranges(lambda a, b: _count(table, count_in, tile, masks, starts, a, b), tiles, grain)
    size, pairs = _lay_out(starts, UNIT)
    inputs = arena.take(f"{name}.inputs", (size,), np.int32)
    outputs = arena.take(f"{name}.outputs", (size,), np.int32)
    workers.ranges(lambda a, b: _fill(table, tile, masks, starts, inputs, outputs, a, b), tiles, grain)
    return KernelMap(inputs, outputs, starts, tile, count_in, count, pairs)


def up_map(fine: Scale, count_coarse: int, arena: Arena, workers: Workers, name: str) -> KernelMap:
    """Kernel map from the coarser scale up to `fine`: a voxel has its parent, at the offset of its octant."""
    count = len(fine.keys)
    tile = tile_size(count, workers)
    tiles = -(-count // tile)
    starts = arena.take(f"{name}.starts", (tiles, 9), np.int32)
    starts[:] = 0
    _count_octants(fine.keys, tile, starts)
    size, pairs = _lay_out(starts, UNIT)
    inputs = arena.take(f"{name}.inputs", (size,), np.int32)
    outputs = arena.take(f"{name}.outputs", (size,), np.int32)
    _fill_octants(fine.keys, fine.parent, tile, starts, inputs, outputs)
    return KernelMap(inputs, outputs, starts, tile, count_coarse, count, pairs)


@compiled
def _levels(context, difference):  # type: ignore[no-untyped-def]
    """Digits of three bits that an int64 above 0 has."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        bits = builder.sub(ir.Constant(ir.IntType(64), 66), builder.ctlz(args[0], ir.Constant(ir.IntType(1), True)))
        return builder.udiv(bits, ir.Constant(ir.IntType(64), 3))

    return types.int64(types.int64), generate


@kernel
def _count_scales(keys, sizes):  # type: ignore[no-untyped-def]
    """Number of different `keys >> 3 * level` for each level."""
    for i in range(1, keys.size):
        sizes[_levels(keys[i] ^ keys[i - 1])] += 1  # the two differ at all levels below
    for level in range(20, -1, -1):
        sizes[level] += sizes[level + 1]
    for level in range(21):  # levels at which two neighbours differ, plus the first voxel
        sizes[level] = sizes[level + 1] + 1
    sizes[21] = 1


@kernel
def _coarsen(keys, parent, coarse_keys, starts, child):  # type: ignore[no-untyped-def]
    c = -1
    for v in range(keys.size):
        above = keys[v] >> 3
        if c < 0 or above != coarse_keys[c]:
            c += 1
            coarse_keys[c] = above
            starts[c] = v
            for octant in range(8):
                child[c, octant] = keys.size
        parent[v] = c
        child[c, keys[v] & 7] = v
    starts[coarse_keys.size] = keys.size


def _paths() -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """For a voxel in each octant and each of 27 offsets: the offset of the parent and the octant in it."""
    octant, offset = np.arange(8)[:, None], np.arange(27)[None, :]
    x = (octant >> 2) + offset % 3 - 1
    y = (octant >> 1 & 1) + offset // 3 % 3 - 1
    z = (octant & 1) + offset // 9 - 1
    parent = (x >> 1) + 1 + 3 * ((y >> 1) + 1) + 9 * ((z >> 1) + 1)
    return parent.astype(np.uint64), ((x & 1) * 4 + (y & 1) * 2 + (z & 1)).astype(np.uint64)


_PARENT_OFFSET, _CHILD_OCTANT = _paths()


@kernel
def _neighbours(keys, parent, child, above, table, start, stop):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        v = np.uint64(i)  # Numba looks at each signed index whether it counts from the end
        octant, p = np.uint64(keys[v] & 7), np.uint64(parent[v])
        for j in range(27):
            k = np.uint64(j)
            table[v, k] = child[np.uint64(above[p, _PARENT_OFFSET[octant, k]]), _CHILD_OCTANT[octant, k]]


@compiled
def _lowest_bit(context, mask):  # type: ignore[no-untyped-def]
    """Place of the lowest set bit of a uint32 other than 0."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), True))

    return types.uint32(types.uint32), generate


@kernel
def _count(table, none, tile, masks, starts, first, last):  # type: ignore[no-untyped-def]
    """Leaves the number of pairs of offset k in starts[t, k + 1] and the offsets that exist in masks[v]."""
    for t in range(first, last):
        for k in range(starts.shape[1]):
            starts[t, k] = 0
        low = t * tile
        high = min(low + tile, table.shape[0] - 1)
        for v in range(low, high):
            mask = np.uint32(0)
            for k in range(table.shape[1]):
                mask |= np.uint32(table[v, k] != none) << np.uint32(k)
            masks[v] = mask
            while mask:
                starts[t, _lowest_bit(mask) + 1] += 1
                mask &= mask - np.uint32(1)


@kernel
def _lay_out(starts, unit):  # type: ignore[no-untyped-def]
    """Numbers of pairs to first pairs; returns the number of pairs with and without those that fill up."""
    place = 0
    pairs = 0
    for t in range(starts.shape[0]):
        starts[t, 0] = place
        for k in range(1, starts.shape[1]):
            number = starts[t, k]
            pairs += number
            if number:
                place += max(2, -(-number // unit)) * unit
            starts[t, k] = place
    return place, pairs


@kernel
def _fill(table, tile, masks, starts, inputs, outputs, first, last):  # type: ignore[no-untyped-def]
    offsets = table.shape[1]
    places = np.empty(offsets, np.int32)
    for t in range(first, last):
        for k in range(offsets):
            places[k] = starts[t, k]
        low = t * tile
        for v in range(low, min(low + tile, table.shape[0] - 1)):
            mask = masks[v]
            while mask:
                k = _lowest_bit(mask)
                mask &= mask - np.uint32(1)
                place = places[k]
                places[k] = place + 1
                inputs[place] = table[v, k]
                outputs[place] = v - low
        for k in range(offsets):
            for place in range(places[k], starts[t, k + 1]):
                inputs[place] = 0
                outputs[place] = tile


@kernel
def _count_octants(keys, tile, starts):  # type: ignore[no-untyped-def]
    for v in range(keys.size):
        starts[v // tile, (keys[v] & 7) + 1] += 1


@kernel
def _fill_octants(keys, parent, tile, starts, inputs, outputs):  # type: ignore[no-untyped-def]
    places = np.empty(8, np.int64)
    for t in range(starts.shape[0]):
        for k in range(8):
            places[k] = starts[t, k]
        low = t * tile
        for v in range(low, min(low + tile, keys.size)):
            octant = keys[v] & 7
            inputs[places[octant]] = parent[v]
            outputs[places[octant]] = v - low
            places[octant] += 1
        for k in range(8):
            for place in range(places[k], starts[t, k + 1]):
                inputs[place] = 0
                outputs[place] = tile
