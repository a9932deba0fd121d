"""One matrix by LAPACK, a batch without its batched calls, which can wait for each other for ever on two threads."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.types import Array

LEAST = 8  # items: fewer do not fill a vector


def batched(
    single: Callable[..., Any], behind: Callable[..., Any] | None = None, most: int = 0, *, shared: bool = False
) -> Any:
    """Return a function of one item whose batches, as `vmap` makes them, call no batched LAPACK on a CPU.

    Args:
        single: arrays to a tuple of arrays, by LAPACK.
        behind: the same with an axis more behind all arrays.
        most: columns of the first argument up to which `behind` is quicker than LAPACK's calls one after the other.
        shared: whether the second of two arguments has columns that do not know of each other; then a batch that
            shares its first is one call with more columns.

    Returns:
        The function. It has no derivative.
    """

    def side_by_side(*args: Array) -> Any:
        if behind is None or args[0].shape[-1] > most or len(args[0]) < LEAST:
            return jax.lax.map(lambda item: single(*item), args)
        found = behind(*(jnp.moveaxis(x, 0, -1) for x in args))
        return tuple(jnp.moveaxis(x, -1, 0) for x in found)

    @jax.custom_batching.custom_vmap
    def many(*args: Array) -> Any:
        return jax.lax.platform_dependent(*args, cpu=side_by_side, default=jax.vmap(single))

    @many.def_vmap
    def _(size: int, is_batched: Any, *args: Array) -> Any:
        args = _filled(size, is_batched, args)
        count = args[0].shape[1]
        found = many(*(x.reshape(size * count, *x.shape[2:]) for x in args))
        return tuple(x.reshape(size, count, *x.shape[1:]) for x in found), (True,) * len(found)

    one = jax.custom_batching.custom_vmap(single)

    @one.def_vmap
    def _(size: int, is_batched: Any, *args: Array) -> Any:
        if shared and not is_batched[0]:
            a, b = args
            found = one(a, jnp.moveaxis(b, 0, -1).reshape(*b.shape[1:-1], -1))
            x = jnp.moveaxis(found[0].reshape(*b.shape[1:], size), -1, 0)
            return (x, *found[1:]), (True, *(False for _ in found[1:]))
        found = many(*_filled(size, is_batched, args))
        return found, (True,) * len(found)

    return one


def _filled(size: int, is_batched: Any, args: tuple[Array, ...]) -> tuple[Array, ...]:
    return tuple(
        x if there else jnp.broadcast_to(x, (size, *x.shape)) for x, there in zip(args, is_batched, strict=True)
    )


__all__ = ["batched"]
