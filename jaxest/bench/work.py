"""How much work a program is, counted, against what this machine can do, measured.

The floor of a program is the longer of two times: its arithmetic at the measured peak, and its arguments and results
moved once at the measured bandwidth. Arithmetic is counted in the traced program, where loops are multiplied by their
lengths, which XLA's own analysis leaves out; an elementary function counts as one operation, so the floor is low.
"""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

FREE = {
    "broadcast_in_dim", "reshape", "squeeze", "transpose", "slice", "concatenate", "convert_element_type", "copy",
    "gather", "dynamic_slice", "dynamic_update_slice", "iota", "stop_gradient", "split", "pad", "rev", "expand_dims",
    "random_wrap", "random_unwrap", "device_put", "bitcast_convert_type", "copy_p", "scatter",
}  # fmt: skip
"""Primitives that move numbers and compute none."""


class Work(NamedTuple):
    """What a program does."""

    operations: float
    """Additions, multiplications, comparisons and elementary functions."""
    bytes: float
    """Of arguments and results."""


class Peak(NamedTuple):
    """What the machine does, measured with all its threads."""

    operations: float
    """float32 operations a second, of a matrix product."""
    bandwidth: float
    """bytes a second, read and written, of a copy that no cache holds."""

    def floor(self, work: Work) -> float:
        """Return the shortest time, s, in which the work could be done."""
        return max(work.operations / self.operations, work.bytes / self.bandwidth)


def count(fn: Callable[..., Any], *args: Any) -> Work:
    """Count the work of a function at given arguments.

    Args:
        fn: any function of arrays; a loop whose length depends on data counts once.
        args: its arguments, or their shapes.

    Returns:
        The work.
    """
    closed = jax.make_jaxpr(fn)(*args)
    moved = sum(_bytes(v.aval) for v in (*closed.jaxpr.invars, *closed.jaxpr.outvars))
    return Work(_operations(closed.jaxpr), moved)


def _bytes(aval: Any) -> float:
    size = math.prod(getattr(aval, "shape", ()))
    try:
        return float(size * np.dtype(aval.dtype).itemsize)
    except TypeError:  # a random key
        return 8.0 * size


def _operations(jaxpr: Any) -> float:
    total = 0.0
    for equation in jaxpr.eqns:
        name, params = equation.primitive.name, equation.params
        inner = [_operations(sub) for sub in _programs(params)]
        if name == "scan":
            total += params["length"] * sum(inner)
        elif name == "cond":
            total += max(inner)
        elif inner:
            total += sum(inner)
        elif name == "dot_general":
            (left, _), _ = params["dimension_numbers"]
            shape = equation.invars[0].aval.shape
            total += 2.0 * math.prod(equation.outvars[0].aval.shape) * math.prod(shape[i] for i in left)
        elif name not in FREE:
            reads = [math.prod(getattr(v.aval, "shape", ())) for v in (*equation.invars, *equation.outvars)]
            total += max(reads, default=0)
    return total


def _programs(params: Mapping[str, Any]) -> list[Any]:
    """The traced programs inside an equation."""
    found = []
    for value in params.values():
        for entry in value if isinstance(value, list | tuple) else (value,):
            inner = getattr(entry, "jaxpr", entry)
            if hasattr(inner, "eqns"):
                found.append(inner)
    return found


def peak(size: int = 1024, megabytes: int = 64, repeats: int = 5) -> Peak:
    """Measure the machine, the best of a few runs: nothing runs faster than its fastest.

    Args:
        size: side of the matrices to begin with; doubled while a product takes less than 5 ms, which on an accelerator
            is its start more than its work.
        megabytes: of the array that is copied, more than the caches hold; doubled in the same way.
        repeats: runs.

    Returns:
        The peak, in a second or two.
    """
    product = jax.jit(lambda a: jnp.matmul(a, a, precision="highest"))  # an accelerator else shortens its inputs
    side, multiplied = _grown(product, lambda n: jnp.ones((n, n), jnp.float32), size, 16384, repeats)
    copy = jax.jit(lambda x: x + 1)
    length, moved = _grown(copy, lambda n: jnp.ones(n * 250_000, jnp.float32), megabytes, 8192, repeats)
    return Peak(2.0 * side**3 / multiplied, 2e6 * length / moved)


def _grown(fn: Any, build: Callable[[int], Any], size: int, most: int, repeats: int) -> tuple[int, float]:
    """The size at which a call takes long enough to be measured, and how long, s."""
    seconds = _best(fn, build(size), repeats)
    while seconds < 5e-3 and size < most:
        size *= 2
        seconds = _best(fn, build(size), repeats)
    return size, seconds


def _best(fn: Callable[[Any], Any], x: Any, repeats: int) -> float:
    jax.block_until_ready(fn(x))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(fn(x))
        times.append(time.perf_counter() - start)
    return min(times)


__all__ = ["Peak", "Work", "count", "peak"]
