"""What holds of every estimator's state: how it begins, and that no number leaves the precision unnoticed."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from jaxest.types import OUT_OF_RANGE, Array

State = TypeVar("State")


def apart(state: State) -> State:
    """Give each leaf of a first state memory of its own, so that a step may be told to reuse it (`donate_argnums`)."""
    return jax.tree.map(jnp.copy, state)


def finite(tree: Any) -> Array:
    """Return whether all floating leaves are finite, () bool."""
    leaves = [x for x in jax.tree.leaves(tree) if jnp.issubdtype(x.dtype, jnp.floating)]
    return jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in leaves]))


def within_range(before: Any, after: Any, info: Any) -> tuple[Any, Any]:
    """Take a step where all of its numbers are finite, and otherwise none, with a word.

    Args:
        before: the state that the step began with.
        after: the state that it led to.
        info: what it says; has a `status`.

    Returns:
        The state, which is the one before where a number outgrew the precision, the step being counted; and the info,
        whose status is `OUT_OF_RANGE` there.
    """
    fits = finite((after, info))
    kept = jax.tree.map(lambda new, old: jnp.where(fits, new, old), after, before._replace(index=after.index))
    return kept, info._replace(status=jnp.where(fits, info.status, OUT_OF_RANGE))


__all__ = ["apart", "finite", "within_range"]
