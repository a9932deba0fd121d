"""Angles, rotations and rigid motions: where states live that are no vectors.

Which element, which module: one angle `circle` (), a rotation `quaternion` (4,) wxyz or `so3` (3, 3), a rigid motion
`se3` (`Pose`), anything flat `Euclidean((3,))`, many of one kind `Power(circle, 7)`, a state of several
`product.of(State(orientation=quaternion, bias=Euclidean((3,))))`.

All of them are a `Manifold`: start with `retract(x, v)` (perturb on the right), `local(x, y)` (its inverse),
`mean(xs, weights)` and `interpolate(x, y, t)`; tangent vectors have shape (dim,), rotation before translation. The
four modules are also a `Group`: `exp`, `log`, `compose`, `inverse`, `identity`, `adjoint` and the Jacobians.

Every function takes one element (`vmap` adds batches), keeps its dtype, and is right to a few eps, with its
derivatives, from no rotation to half a turn. Probability on these spaces is not here.
"""

from jaxest.manifolds import circle, product, quaternion, se3, so3
from jaxest.manifolds.base import Group, Manifold
from jaxest.manifolds.euclidean import Euclidean
from jaxest.manifolds.product import Power, Product
from jaxest.manifolds.se3 import Pose

__all__ = [
    "Euclidean",
    "Group",
    "Manifold",
    "Pose",
    "Power",
    "Product",
    "circle",
    "product",
    "quaternion",
    "se3",
    "so3",
]
