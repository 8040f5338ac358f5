"""The inner loops of sparse convolution: explicit vector code over tiles of outputs.

A tile keeps its accumulators in the cache. For each kernel offset, the tile's pairs are taken three or two
`UNIT`s at a time: that many gathered input rows times a panel of 16 output channels, all in registers. LLVM
maps the 16-wide vectors to what the processor has (two AVX2, one AVX-512 or four NEON registers each).
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from runtime.compute.atomics import fetch_add, wait_for
from runtime.compute.internals import target
from runtime.compute.jit import compiled, ir, kernel, types

LANES = 16  # output channels of one panel; channel counts are filled up to a multiple of it
# Pairs are taken in threes and twos of this many: 6 and 4 rows fill 16 vector registers, 12 and 8 rows 32. It
# depends on the features that Numba compiles for, as its cache of compiled code does.
UNIT = 4 if "+avx512f" in target()[2] else 2
SLOPE = 0.01  # of LeakyReLU, below 0
UNROLL = 4  # input channels per turn of the innermost loop; divides LANES


# What `run_layers` has to know of a layer: addresses of arrays, and lengths of their rows in floats.
FIELDS = (
    "source", "row_length", "weights", "depth", "panels", "offsets", "inputs", "outputs", "starts",
    "side", "side_length", "side_weights", "side_depth", "bias",
    "after", "residual", "residual_length", "out", "out_length", "relu", "tile", "count", "blocks",
)  # fmt: skip
(
    SOURCE, ROW_LENGTH, WEIGHTS, DEPTH, PANELS, OFFSETS, INPUTS, OUTPUTS, STARTS,
    SIDE, SIDE_LENGTH, SIDE_WEIGHTS, SIDE_DEPTH, BIAS,
    AFTER, RESIDUAL, RESIDUAL_LENGTH, OUT, OUT_LENGTH, RELU, TILE, COUNT, BLOCKS,
) = range(len(FIELDS))  # fmt: skip

_WORD, _INDEX, _VECTOR = ir.IntType(32), ir.IntType(64), ir.VectorType(ir.FloatType(), LANES)
_ZERO = ir.Constant(_VECTOR, [0.0] * LANES)


def _block(rows: int) -> Callable[..., Any]:
    """An intrinsic: `rows` gathered input rows times one panel, added to the sums of `rows` outputs.

    Addresses of the input, of int32 row numbers, of the panel (depth, 16), of the sums (outputs, 16) and of
    int32 output numbers; `row_length` in floats.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source, row_length, inputs, panel, depth, sums, outputs = args
        undefined = ir.Constant(_VECTOR, ir.Undefined)
        everywhere = ir.Constant(ir.VectorType(_WORD, LANES), [0] * LANES)

        def gathered(start: Any, numbers: Any, stride: Any, kind: Any) -> list[Any]:
            numbers = builder.inttoptr(numbers, _WORD.as_pointer())
            pointers = []
            for r in range(rows):
                number = builder.sext(builder.load(builder.gep(numbers, [_INDEX(r)])), _INDEX)
                address = builder.add(start, builder.mul(number, stride))
                pointers.append(builder.inttoptr(address, kind.as_pointer()))
            return pointers

        from_rows = gathered(source, inputs, builder.mul(row_length, _INDEX(4)), ir.FloatType())
        to_rows = gathered(sums, outputs, _INDEX(4 * LANES), _VECTOR)
        panel = builder.inttoptr(panel, _VECTOR.as_pointer())
        before, loop, after = builder.block, builder.append_basic_block(), builder.append_basic_block()
        builder.branch(loop)
        builder.position_at_end(loop)
        step = builder.phi(_INDEX)
        starts = [builder.phi(_VECTOR) for _ in range(rows)]
        totals = list(starts)
        for channel in [builder.add(step, _INDEX(u)) for u in range(UNROLL)]:
            weights = builder.load(builder.gep(panel, [channel]), align=4)
            for r in range(rows):
                value = builder.load(builder.gep(from_rows[r], [channel]))
                value = builder.insert_element(undefined, value, _WORD(0))
                value = builder.shuffle_vector(value, undefined, everywhere)
                product = builder.fmul(value, weights, flags=("contract",))
                totals[r] = builder.fadd(product, totals[r], flags=("contract",))  # a fused multiply-add
        following = builder.add(step, _INDEX(UNROLL))
        step.add_incoming(_INDEX(0), before)
        step.add_incoming(following, loop)
        for start, total in zip(starts, totals, strict=True):
            start.add_incoming(_ZERO, before)
            start.add_incoming(total, loop)
        builder.cbranch(builder.icmp_signed("<", following, depth), loop, after)
        builder.position_at_end(after)
        for row, total in zip(to_rows, totals, strict=True):
            builder.store(builder.fadd(total, builder.load(row, align=4)), row, align=4)
        return context.get_dummy_value()

    @compiled
    def block(context, source, row_length, inputs, panel, depth, sums, outputs):  # type: ignore[no-untyped-def]
        return types.void(*[types.intp] * 7), generate

    return block  # type: ignore[no-any-return]


_three_units, _two_units = _block(3 * UNIT), _block(2 * UNIT)


@compiled
def _finish(context, sums, scale, shift, residual, out, relu):  # type: ignore[no-untyped-def]
    """Store 16 channels of an output: their sums, plus the residual (address 0: none), and ReLU if asked.

    scale, shift: addresses, of what LeakyReLU of the sums is multiplied by, and what is added, before the residual; 0
    as the scale: neither.
    """

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        sums, scale, shift, residual, out = (builder.inttoptr(one, _VECTOR.as_pointer()) for one in args[:5])
        total = builder.load(sums, align=4)
        before = builder.block
        with builder.if_then(builder.icmp_signed("!=", args[1], _INDEX(0))):
            small = builder.fmul(total, ir.Constant(_VECTOR, [SLOPE] * LANES))
            leaky = builder.select(builder.fcmp_ordered("<", total, _ZERO), small, total)  # NaN stays NaN
            normed = builder.fadd(builder.fmul(leaky, builder.load(scale, align=4)), builder.load(shift, align=4))
            inside = builder.block
        value = builder.phi(_VECTOR)
        value.add_incoming(total, before)
        value.add_incoming(normed, inside)
        before = builder.block
        with builder.if_then(builder.icmp_signed("!=", args[3], _INDEX(0))):
            added = builder.fadd(value, builder.load(residual, align=4))
            inside = builder.block
        total = builder.phi(_VECTOR)
        total.add_incoming(value, before)
        total.add_incoming(added, inside)
        positive = builder.select(builder.fcmp_ordered("<", total, _ZERO), _ZERO, total)
        builder.store(builder.select(args[5], positive, total), out, align=4)
        return context.get_dummy_value()

    return types.void(*[types.intp] * 5, types.boolean), generate


@compiled
def _load_int32(context, address, index):  # type: ignore[no-untyped-def]
    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        place = builder.gep(builder.inttoptr(args[0], _WORD.as_pointer()), [args[1]])
        return builder.sext(builder.load(place), _INDEX)

    return types.intp(types.intp, types.intp), generate


@compiled
def _copy_lanes(context, source, target):  # type: ignore[no-untyped-def]
    """Copy the 16 floats at address `source` to `target`."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        source, target = (builder.inttoptr(address, _VECTOR.as_pointer()) for address in args)
        builder.store(builder.load(source, align=4), target, align=4)
        return context.get_dummy_value()

    return types.void(types.intp, types.intp), generate


@kernel
def address(array):  # type: ignore[no-untyped-def]
    """Of an array's first element; NumPy itself takes six times as long to tell."""
    return array.ctypes.data


@kernel
def _add_pairs(  # type: ignore[no-untyped-def]
    source, row_length, depth, panels, panel, inputs, outputs, number, sums, sums_size
):  # fmt: skip
    """Add `number` pairs of one kernel offset, a multiple of UNIT and at least two, to the sums of a tile."""
    twos = -(number // UNIT) % 3
    threes = (number // UNIT - 2 * twos) // 3
    for _panel in range(panels):
        i = 0
        for _ in range(threes):
            _three_units(source, row_length, inputs + i, panel, depth, sums, outputs + i)
            i += 12 * UNIT
        for _ in range(twos):
            _two_units(source, row_length, inputs + i, panel, depth, sums, outputs + i)
            i += 8 * UNIT
        panel += depth * 64
        sums += sums_size


@kernel
def _run_task(layer, task, sums, ahead, here):  # type: ignore[no-untyped-def]
    """One tile of outputs, some of its panels; `layer` holds the FIELDS, `sums` is an address."""
    tile, panels, depth = layer[TILE], layer[PANELS], layer[DEPTH]
    t, block = task // layer[BLOCKS], task % layer[BLOCKS]
    first, last = block * panels // layer[BLOCKS], (block + 1) * panels // layer[BLOCKS]
    low = t * tile
    number = min(tile, layer[COUNT] - low)
    sums_size = (tile + 1) * 64
    for p in range(first, last):
        for r in range(number):
            _copy_lanes(layer[BIAS] + p * 64, sums + (p - first) * sums_size + r * 64)
    starts = layer[STARTS] + 4 * t * (layer[OFFSETS] + 1)
    begin = _load_int32(starts, 0) if layer[OFFSETS] else 0
    for k in range(layer[OFFSETS]):
        end = _load_int32(starts, k + 1)
        if end > begin:
            _add_pairs(
                layer[SOURCE], layer[ROW_LENGTH], depth,
                last - first, layer[WEIGHTS] + 64 * depth * (k * panels + first),
                layer[INPUTS] + 4 * begin, layer[OUTPUTS] + 4 * begin, end - begin, sums, sums_size,
            )  # fmt: skip
        begin = end
    if layer[SIDE_DEPTH]:
        filled = max(2, -(-number // UNIT)) * UNIT
        for i in range(filled):
            ahead[i] = i if i < number else 0
            here[i] = i if i < number else tile  # row `tile` takes the pairs that fill up
        _add_pairs(
            layer[SIDE] + 4 * low * layer[SIDE_LENGTH], layer[SIDE_LENGTH], layer[SIDE_DEPTH],
            last - first, layer[SIDE_WEIGHTS] + 64 * layer[SIDE_DEPTH] * first,
            ahead.ctypes.data, here.ctypes.data, filled, sums, sums_size,
        )  # fmt: skip
    shift = layer[AFTER] + 64 * panels  # behind the scales
    for r in range(number):
        for p in range(first, last):
            _finish(
                sums + (p - first) * sums_size + r * 64,
                layer[AFTER] + p * 64 if layer[AFTER] else 0,
                shift + p * 64,
                layer[RESIDUAL] + 4 * ((low + r) * layer[RESIDUAL_LENGTH] + p * 16) if layer[RESIDUAL] else 0,
                layer[OUT] + 4 * ((low + r) * layer[OUT_LENGTH] + p * 16),
                layer[RELU] != 0,
            )


@kernel
def run_layers(layers, progress):  # type: ignore[no-untyped-def]
    """Work on `layers` (L, len(FIELDS)), one after the other, together with all threads that call this.

    `progress` (L, 2, 8) starts as zeros: of each layer, tasks that a thread has taken and tasks that are done, a cache
    line each. A layer begins when the one before is done; a thread that comes late finds less to do.
    """
    space = tile = 0
    for layer in layers:
        space = max(space, -(-layer[PANELS] // layer[BLOCKS]) * (layer[TILE] + 1))
        tile = max(tile, layer[TILE])
    sums = np.empty((space, 16), np.float32)
    ahead, here = np.empty(tile + 2 * UNIT, np.int32), np.empty(tile + 2 * UNIT, np.int32)
    taken = progress.ctypes.data
    for layer in layers:
        tasks = -(-layer[COUNT] // layer[TILE]) * layer[BLOCKS]
        task = fetch_add(taken)
        while task < tasks:
            _run_task(layer, task, sums.ctypes.data, ahead, here)
            fetch_add(taken + 64)  # done
            task = fetch_add(taken)
        wait_for(taken + 64, tasks)
        taken += 128
