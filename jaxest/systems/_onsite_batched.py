"""A step of many items at once with the batch behind all other axes, where XLA on CPU makes vector code of it."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.types import Array

LEAST = 8  # items: fewer do not fill a vector


def batched(step: Callable[..., Any]) -> Callable[..., Any]:
    """Return a step that `vmap` runs with the batch behind.

    Args:
        step: `(params, state, measurement, go) -> (state, info)`. With `go` None of one item; else, `go` as
            `filters._small.held` wants it, leaves have one more axis behind, of the batch; those of the parameters
            have one of 1 where they are the same for all items, and `state.index` then has none.

    Returns:
        `(params, state, measurement) -> (state, info)` of one item, for `vmap`, `grad` and `jit`. Its derivatives are
        those of `step` with None.
    """
    single = functools.partial(step, go=None)
    mapped = jax.custom_batching.custom_vmap(single)

    @mapped.def_vmap
    def _(size: int, is_batched: Any, params: Any, state: Any, measurement: Any) -> Any:
        given = (params, state, measurement)
        if size < LEAST:
            axes = jax.tree.map(lambda there: 0 if there else None, tuple(is_batched))
            found = jax.vmap(single, in_axes=axes, axis_size=size)(*given)
            return found, jax.tree.map(lambda _: True, found)
        return _behind(step, size, is_batched, *given)

    @jax.custom_jvp
    def stepped(params: Any, state: Any, measurement: Any) -> Any:
        return mapped(params, state, measurement)

    @stepped.defjvp
    def _(primals: Any, tangents: Any) -> Any:
        return jax.jvp(lambda *given: jax.tree.map(_in_front, single(*given)), primals, tangents)

    return stepped


def _in_front(x: Array) -> Array:
    """Return x; a batch that `vmap` adds then lies in front, as `custom_jvp` takes for granted after `custom_vmap`."""
    return x.reshape((*x.shape, 1)).reshape(x.shape)


def _behind(step: Callable[..., Any], size: int, is_batched: Any, params: Any, state: Any, measurement: Any) -> Any:
    def move(x: Array, there: bool) -> Array:
        return jnp.moveaxis(x, 0, -1) if there else jnp.asarray(x)[..., None]

    settings = jax.tree.map(move, params, is_batched[0])
    counted = is_batched[1].index
    index = state.index
    widened = (jax.tree.map(move, *x) for x in ((state, is_batched[1]), (measurement, is_batched[2])))
    state, measurement = jax.tree.map(lambda x: jnp.broadcast_to(x, (*x.shape[:-1], size)), tuple(widened))
    state = state._replace(index=index)
    after, info = step(settings, state, measurement, go=jnp.any(index >= 0))
    found = jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0) if jnp.ndim(x) else x, (after, info))
    flags = jax.tree.map(lambda _: True, found)
    return found, (flags[0]._replace(index=counted), flags[1])


__all__ = ["batched"]
