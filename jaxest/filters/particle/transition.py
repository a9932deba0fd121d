"""How a state moves on: a mean, and noise in the tangent space at it."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.manifolds.base import Manifold
from jaxest.types import Array, ArrayLike, PyTree


class Opening(NamedTuple):
    """The law of the first state by itself, for a first step that need not start from the particles drawn before it.

    Particles spread over all states seldom lie within reach of what the first measurement says. All functions, static.
    A coordinate may keep to the particle's own way; its mean, precision and density are the transition's then. Or
    searches start all over the states and are told so by `scattered`.
    """

    centre: Callable[[PyTree, PyTree, PyTree], PyTree]
    """`(params, x, measurement) -> x`, near what is measured: the tangent space is taken there."""
    mean: Callable[[PyTree, PyTree, PyTree], PyTree]
    """`(params, x, measurement) -> x` of the law."""
    precision: Callable[[PyTree, PyTree], Array]
    """`(params, measurement) -> (d,)` of a Gaussian like it; good ones save particles."""
    log_prob: Callable[[PyTree, PyTree, PyTree, Array, PyTree], Array]
    """`(params, x, moved, v, measurement) -> ()` log-density of the first state `moved`, exact; v (d,) leads there from
    the centre, for coordinates that keep to the particle's way."""
    scattered: Callable[[PyTree, PyTree], Array] | None = None
    """`(params, measurement) -> () bool`, whether particles' searches may end in several states that the measurement
    takes for one another. Draws are then weighed against many Gaussians together, as one alone misses the other
    states; `log_prob` must not look at x or v then. Never if None."""


class Transition(NamedTuple):
    """The next state is `retract(mean(params, x, measurement), v)` with noise v (d,) that does not depend on x.

    All functions, static; every `Reading` of the measurement they see is finite, 0 where it is invalid. For von Mises
    noise hand its sampler and density, and as precision a concentration (0.8 kappa has the tails of a density with
    kappa below 10 covered); for Gaussian noise see `gaussian`.
    """

    mean: Callable[[PyTree, PyTree, PyTree], PyTree]
    """`(params, x, measurement) -> x`, `measurement.dt` later."""
    draw: Callable[[PyTree, PyTree, Array, int], Array]
    """`(params, measurement, key, count) -> (count, d)` noise for all particles at once."""
    log_prob: Callable[[PyTree, Array, PyTree], Array]
    """`(params, v, measurement) -> ()` log-density of the noise v (d,), exact."""
    precision: Callable[[PyTree, PyTree], Array]
    """`(params, measurement) -> (d,)` or (d, d) positive definite, of a Gaussian like the noise; only `guided` asks,
    and any value is right, good ones save particles."""
    bounded: bool | tuple[bool, ...] = True
    """Whether noise ends at half a turn, as the density of an angle does: what a proposal draws beyond then weighs
    nothing. False for noise that may go round, such as Gaussian noise of an angle or a rotation vector. One for all or
    for each of the d coordinates."""
    guess: Callable[[PyTree, PyTree, PyTree], Array] | None = None
    """`(params, mean, measurement) -> (d,)` noise that a search for the most probable state had better start from, such
    as what leads to an encoder's reading; 0 if None. Only `guided` asks."""
    opening: Opening | None = None
    """The law of the first state, where it is known in closed form. Only `guided` asks."""


def gaussian(
    mean: Callable[[PyTree, PyTree, PyTree], PyTree], deviation: Callable[[PyTree, PyTree], ArrayLike]
) -> Transition:
    """Return a transition with independent Gaussian noise in the tangent space.

    Args:
        mean: `(params, x, measurement) -> x`.
        deviation: `(params, measurement) -> (d,)` standard deviations over that step, positive.

    Returns:
        The transition.
    """

    def draw(params: PyTree, measurement: PyTree, key: Array, count: int) -> Array:
        scale = jnp.asarray(deviation(params, measurement))
        return scale[None] * jax.random.normal(key, (count, scale.shape[0]), scale.dtype)

    def log_prob(params: PyTree, v: Array, measurement: PyTree) -> Array:
        scale = jnp.asarray(deviation(params, measurement), v.dtype)
        return -jnp.sum((v / scale) ** 2 / 2 + jnp.log(scale) + jnp.log(2 * jnp.pi).astype(v.dtype) / 2)

    def precision(params: PyTree, measurement: PyTree) -> Array:
        return 1 / jnp.square(jnp.asarray(deviation(params, measurement)))

    return Transition(mean, draw, log_prob, precision, bounded=False)


def log_density(
    manifold: Manifold, transition: Transition, params: PyTree, x: PyTree, moved: PyTree, v: Array, measurement: PyTree
) -> Array:
    """Return the log-density () of going from x to where the noise v (d,) led, `moved`.

    Its derivative is that of the density at a fixed end: what the parameters move is the mean, and so the noise that
    the same end takes.
    """
    way = manifold.local(transition.mean(params, x, measurement), moved)
    density = transition.log_prob(params, v + (way - jax.lax.stop_gradient(way)), measurement)
    return jnp.where(direct(transition, way, v), density, -jnp.inf)


def direct(transition: Transition, way: Array, v: Array) -> Array:
    """Return whether noise v (d,) that must end at half a turn does so: () bool, from the short way (d,) to its end."""
    if not transition.bounded:
        return jnp.ones((), bool)
    near = jnp.abs(way - v) < 1  # not so where v went more than half a turn
    return jnp.all(near if transition.bounded is True else near | ~np.array(transition.bounded))


__all__ = ["Opening", "Transition", "gaussian", "log_density"]
