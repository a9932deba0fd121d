"""Whether a manifold is flat, so that tangent spaces need not be carried along."""

from typing import Any

from jaxest.manifolds import Euclidean, Power, Product, circle


def flat(manifold: Any) -> bool:
    """Return whether `retract(x, v)` moves as v does, everywhere: angles and vectors."""
    if isinstance(manifold, Power):
        return flat(manifold.base)
    if isinstance(manifold, Product):
        return all(flat(part) for part in manifold.parts)
    return manifold is circle or isinstance(manifold, Euclidean)
