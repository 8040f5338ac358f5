"""Counters that threads of compiled code share without the interpreter."""

import os
import platform
from typing import Any

from runtime.compute.jit import compiled, ir, kernel, types

_PATIENCE = 2000  # looks at a counter before the processor is offered to other threads
_INDEX = ir.IntType(64)
_ON_X86 = platform.machine().lower() in ("x86_64", "amd64")


@compiled
def fetch_add(context, address):  # type: ignore[no-untyped-def]
    """Add 1 to the int64 at `address` and return what it was."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        place = builder.inttoptr(args[0], _INDEX.as_pointer())
        return builder.atomic_rmw("add", place, _INDEX(1), "seq_cst")

    return types.intp(types.intp), generate


@compiled
def _look(context, address):  # type: ignore[no-untyped-def]
    """The int64 at `address`, which other threads may change."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        return builder.load_atomic(builder.inttoptr(args[0], _INDEX.as_pointer()), "seq_cst", 8)

    return types.intp(types.intp), generate


@compiled
def _pause(context):  # type: ignore[no-untyped-def]
    """Tell an x86 processor that this thread waits, so that the other one on its core is served first."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        if _ON_X86:
            kind = ir.FunctionType(ir.VoidType(), [])
            builder.call(_declared(builder.module, "llvm.x86.sse2.pause", kind), [])
        return context.get_dummy_value()

    return types.void(), generate


@compiled
def _yield(context):  # type: ignore[no-untyped-def]
    """Let another thread run, where the system has a POSIX call for it."""

    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        if os.name == "posix":
            kind = ir.FunctionType(ir.IntType(32), [])
            builder.call(_declared(builder.module, "sched_yield", kind), [])
        return context.get_dummy_value()

    return types.void(), generate


def _declared(module: Any, name: str, kind: Any) -> Any:
    """A function of that type in generated code, declared at its first use."""
    known = module.globals.get(name)
    return ir.Function(module, kind, name) if known is None else known


@kernel
def wait_for(address, number):  # type: ignore[no-untyped-def]
    """Return when the int64 at `address` has reached `number`."""
    looks = 0
    while _look(address) < number:
        _pause()
        looks += 1
        if looks % _PATIENCE == 0:
            _yield()
