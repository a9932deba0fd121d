"""What all distributions do to their arguments first."""

import jax.numpy as jnp

from jaxest.types import Array, ArrayLike


def floating(**arguments: ArrayLike) -> tuple[Array, ...]:
    """Return arguments as floating arrays of one type, broadcast to one shape.

    Args:
        **arguments: arrays (...) by the names that the caller knows them by.

    Returns:
        The arrays in the order given. Numbers without a type of their own take that of the others.

    Raises:
        ValueError: the shapes do not fit together.
    """
    shape = broadcast(**{name: jnp.shape(value) for name, value in arguments.items()})
    dtype = common_dtype(*arguments.values())
    return tuple(jnp.broadcast_to(jnp.asarray(value, dtype), shape) for value in arguments.values())


def common_dtype(*values: ArrayLike) -> jnp.dtype:
    """Return the floating type of arguments taken together; the default one where none has a type of its own."""
    dtype = jnp.result_type(*values)
    return dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)


def broadcast(**shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the common shape of several named ones; raises ValueError naming them where there is none."""
    try:
        return jnp.broadcast_shapes(*shapes.values())
    except ValueError:
        given = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"shapes do not fit together: got {given}, expected equal or broadcastable ones") from None


def fits(shape: tuple[int, ...] | int | None, **shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of a sample: the one asked for, or the parameters' own for None.

    Args:
        shape: what the caller wants, or None.
        **shapes: the parameters' shapes.

    Returns:
        The sample's whole shape.

    Raises:
        ValueError: the parameters do not broadcast to it.
    """
    common = broadcast(**shapes)
    if shape is None:
        return common
    whole = (shape,) if isinstance(shape, int) else tuple(shape)
    held = len(whole) >= len(common) and all(
        n in (1, m) for n, m in zip(reversed(common), reversed(whole), strict=False)
    )
    if not held:
        raise ValueError(f"shape: got {whole}, expected one that the parameters' {common} broadcast to")
    return whole
