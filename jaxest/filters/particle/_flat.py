"""Whether a manifold is flat, so that tangent spaces need not be carried along; and how they are where it is not."""

from typing import Any

import jax
import jax.numpy as jnp

from jaxest.manifolds import Euclidean, Power, Product, circle
from jaxest.types import Array, PyTree


def flat(manifold: Any) -> bool:
    """Return whether `retract(x, v)` moves as v does, everywhere: angles and vectors."""
    if isinstance(manifold, Power):
        return flat(manifold.base)
    if isinstance(manifold, Product):
        return all(flat(part) for part in manifold.parts)
    return manifold is circle or isinstance(manifold, Euclidean)


def carried(manifold: Any, rows: Array, x: PyTree, v: Array) -> Array:
    """Return derivatives in the tangent space at x, where those at `retract(x, v)` are known.

    Part by part, for a product: one derivative of all parts together takes twice as long to compile.

    Args:
        manifold: of dimension d.
        rows: (m, d) derivatives in the tangent space at `retract(x, v)`.
        x: an element of the manifold.
        v: (d,)

    Returns:
        (m, d).
    """
    if flat(manifold):
        return rows
    if isinstance(manifold, Product):
        elements, ends, found = manifold.structure.flatten_up_to(x), 0, []
        for part, element in zip(manifold.parts, elements, strict=True):
            run = slice(ends, ends := ends + part.dim)
            found.append(carried(part, rows[:, run], element, v[run]))
        return jnp.concatenate(found, axis=1)
    if isinstance(manifold, Power):
        blocks = rows.reshape(rows.shape[0], manifold.count, manifold.base.dim)
        each = jax.vmap(lambda *one: carried(manifold.base, *one), (1, 0, 0), 1)
        return each(blocks, x, v.reshape(manifold.count, -1)).reshape(rows.shape)
    if hasattr(manifold, "right_jacobian"):
        turn = manifold.right_jacobian(v)
    else:
        end = manifold.retract(x, v)
        turn = jax.jacfwd(lambda v: manifold.local(end, manifold.retract(x, v)))(v)
    return jnp.matmul(rows, turn, precision=jax.lax.Precision.HIGHEST)
