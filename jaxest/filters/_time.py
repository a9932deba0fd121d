"""The time of a step, which no estimator lets run backwards."""

from typing import Any

import jax.numpy as jnp

from jaxest.types import Array, ArrayLike


def elapsed(dt: ArrayLike, dtype: Any = None) -> tuple[Array, Array]:
    """Return how long a step lasts, and whether its measurement may be used.

    A sample whose time lies before the last one's would turn the estimate back by motion and noise that never were.
    Such a step takes no time and sees nothing, which every estimator can do, and its status says so.

    Args:
        dt: (...) s, time since the previous step.
        dtype: floating type; that of `dt` if None.

    Returns:
        (...) s, 0 where `dt` is negative or not finite; and (...) bool, false there.
    """
    dt = jnp.asarray(dt, dtype)
    timely = (dt >= 0) & jnp.isfinite(dt)
    return jnp.where(timely, dt, 0), timely


__all__ = ["elapsed"]
