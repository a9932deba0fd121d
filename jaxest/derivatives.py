"""What custom derivatives need so that they survive batches.

JAX (0.10) takes the place of a batch axis from a function with a custom derivative itself, not from its rule. Where
the two put the axis in different places, the derivative of a compiled batch, `grad(jit(vmap(f)))`, comes out
transposed or broadcast, without a word. Both therefore return `settled` results.
"""

import jax

from jaxest.types import PyTree


def settled(tree: PyTree) -> PyTree:
    """Put the axis that a surrounding `vmap` has added in front, where it may be anywhere.

    Args:
        tree: arrays of any shape.

    Returns:
        The same; XLA sees a reshape to the same shape.
    """
    return jax.tree.map(lambda x: x[None].reshape(x.shape) if x.ndim else x, tree)


__all__ = ["settled"]
