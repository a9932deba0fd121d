"""One step of a descent: any optax optimiser, or a direction such as L-BFGS's with backtracking.

A step evaluates the objective once, at the point on trial. With backtracking it is taken if the objective has fallen
enough, otherwise a quarter of the step is tried next: no loop inside, so that many starts run in step under `vmap`, and
the state can be kept and resumed after any evaluation.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax

from jaxest.types import Array, PyTree

SUFFICIENT = 1e-4
"""Share of the decrease that the gradient promises which a step must bring (Armijo)."""


class Method(NamedTuple):
    """An optimiser; static, hashed by identity. Build it once."""

    transform: optax.GradientTransformation
    """Whose updates are added, as those of every optax optimiser are; with backtracking the transform of `lbfgs`."""
    backtrack: bool = False
    """Whether a step must bring the objective down; only for objectives without noise, and for `lbfgs`'s transform."""
    longest: float = 1.0
    """Longest step; of logarithms, a factor e."""
    tolerance: float = 1e-4
    """Step, of logarithms a relative change, below which a start has converged; only with backtracking."""
    decrease: float = 1e-7
    """Share of the objective, such that a start has converged where its next step promises no larger decrease, and
    the scale of that step is to be believed; `GRAIN` roundings where that is more. Only with backtracking."""


GRAIN = 8
"""Roundings of the objective, eps times its value, that a decrease must exceed to be seen in it."""
PROBE = 8
"""Times the largest decrease that is not seen, or the step that counts as none: how much a step promises, or how long
it is at least, that is to tell whether a descent goes on."""


def lbfgs(memory: int = 10, *, longest: float = 1.0, tolerance: float = 1e-4, decrease: float = 1e-7) -> Method:
    """Return L-BFGS with backtracking, for objectives without noise.

    Where the objective is not convex along the last step, the next is the longest one downhill. Where a step promises
    nothing that rounding would show, or is shorter than `tolerance`, that may be the bottom or a plateau (which a
    logarithm has where its parameter no longer matters): a step that must show on a plateau is tried, and the descent
    has converged if it is refused.

    Args:
        memory: pairs of steps and gradient differences that are kept.
        longest: longest step.
        tolerance: step below which a start has converged.
        decrease: promised decrease below which it has, as a share of the objective; never less than its rounding
            shows.

    Returns:
        The method.

    Source: Liu, Nocedal 1989, as optax has it.
    """
    return Method(optax.scale_by_lbfgs(memory), True, longest, tolerance, decrease)


def adam(rate: Any = 0.05, *, longest: float = 1.0) -> Method:
    """Return Adam, for mini-batches and for objectives that are drawn.

    Args:
        rate: learning rate, or an optax schedule.
        longest: longest step.

    Returns:
        The method.
    """
    return Method(optax.adam(rate, b2=0.99), longest=longest)


class State(NamedTuple):
    """What the next step needs; the checkpoint of a tuning."""

    trial: Array
    """(n,) where the objective is evaluated next."""
    point: Array
    """(n,) the last point taken."""
    value: Array
    """() objective there; infinite before the first."""
    gradient: Array
    """(n,) there."""
    direction: Array
    """(n,) of the step on trial."""
    share: Array
    """() length of that step as a share of the direction."""
    memory: PyTree
    """The optimiser's."""
    average: Array
    """(n,) mean of the points, the later the heavier: of the i-th of k evaluations by 2 (i - 1) / (k (k - 1))."""
    converged: Array
    """() bool; also where the first value is not finite, for there is nowhere to go. Only with backtracking."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, evaluations."""


class Info(NamedTuple):
    """One evaluation."""

    value: Array
    """() objective on trial."""
    gradient: Array
    """(n,) there."""
    point: Array
    """(n,) the trial."""
    taken: Array
    """() bool, whether it became the point."""


ValueAndGradient = Callable[[Array], tuple[Array, Array]]
"""`z (n,) -> (), (n,)`."""


def init(method: Method, z: Array) -> State:
    """Return the state before the first evaluation, which is at `z` (n,)."""
    zero, no = jnp.zeros_like(z), jnp.zeros((), z.dtype)
    return State(z, z, no + jnp.inf, zero, zero, no, method.transform.init(z), zero, jnp.zeros((), bool), jnp.int32(0))


def step(method: Method, evaluate: ValueAndGradient, state: State) -> tuple[State, Info]:
    """Evaluate the trial, take it or not, and choose the next.

    Args:
        method: the optimiser, static.
        evaluate: objective and gradient.
        state: as `init` or the previous step returned it.

    Returns:
        The next state, and what was found. A value that is not finite is never taken.
    """
    value, gradient = evaluate(state.trial)
    finite = jnp.isfinite(value) & jnp.all(jnp.isfinite(gradient))
    slope = jnp.sum(state.gradient * state.direction) * state.share
    # Rounding makes the last steps of a descent look uphill by a few eps.
    slack = 4 * jnp.finfo(value.dtype).eps * jnp.abs(value)
    first = ~jnp.isfinite(state.value)
    taken = finite & ~state.converged
    if method.backtrack:
        taken = taken & (first | (value <= state.value + SUFFICIENT * slope + slack))
    safe = jnp.where(finite, gradient, 0)
    moved = _taken(method, state, jnp.where(finite, value, 0), safe)
    stayed = _shortened(method, state)
    after = jax.tree.map(lambda a, b: jnp.where(taken, a, b), moved, stayed)
    after = after._replace(
        value=jnp.where(taken, value, state.value),
        converged=state.converged | after.converged,
        average=_averaged(state, taken),
        index=state.index + 1,
    )
    return after, Info(value, gradient, state.trial, taken)


def _taken(method: Method, state: State, value: Array, gradient: Array) -> State:
    """The state once the trial is taken: its gradient gives the next direction."""
    if not method.backtrack:
        update, memory = method.transform.update(gradient, state.memory, state.trial)
        direction, settled = _limited(method, update), jnp.zeros((), bool)
    else:
        direction, memory, settled = _quasi_newton(method, state, value, gradient)
    return state._replace(
        trial=state.trial + direction,
        point=state.trial,
        gradient=gradient,
        direction=direction,
        share=jnp.ones_like(state.share),
        memory=memory,
        converged=settled,
    )


def _quasi_newton(method: Method, state: State, value: Array, gradient: Array) -> tuple[Array, PyTree, Array]:
    """The next direction, the memory, and whether the trial is as low as can be told."""
    moved, changed = state.trial - state.point, gradient - state.gradient
    convex = jnp.sum(moved * changed) > 1e-4 * _length(moved) * _length(changed)
    first = ~jnp.isfinite(state.value)
    # A pair without curvature would make the inverse Hessian indefinite: the memory is told that nothing moved.
    idle = state.memory._replace(params=state.trial, updates=gradient)
    memory = jax.tree.map(lambda a, b: jnp.where(convex | first, a, b), state.memory, idle)
    update, memory = method.transform.update(gradient, memory, state.trial)
    direction = _limited(method, -update)
    promised, slope = -jnp.sum(direction * gradient) / 2, _length(gradient)
    little, short = unseen(method, value), _length(direction) < method.tolerance
    flat, small = slope * method.longest / 2 <= little, promised <= little
    stuck = jnp.abs(value - state.value) <= little
    # A little step clears the steep directions of slope first, so that the next gradient is that of the others.
    trusted = convex & (promised > 0) & ~((small | short) & stuck)
    # The bottom, or a plateau on which the memory's steps are too short? So long a step tells: what it promises shows
    # on a plateau, and from the bottom it leads uphill.
    unclear = ~first & ((convex & (small | short)) | stuck)
    # The memory still knows which directions are steep; its length is what is not believed.
    way = jnp.where(promised > 0, direction, -gradient)
    way = way / jnp.where(slope > 0, _length(way), 1)
    fall = -jnp.sum(way * gradient)
    probe = PROBE * jnp.maximum(little / jnp.where(fall > 0, fall, 1), method.tolerance)
    reach = jnp.where(unclear, jnp.minimum(method.longest, probe), method.longest)
    direction = jnp.where(trusted, direction, way * reach)
    return direction, memory, flat


def _grain(value: Array) -> Array:
    """What rounding may add to an objective."""
    return GRAIN * jnp.finfo(value.dtype).eps * jnp.abs(value)


def unseen(method: Method, value: Array) -> Array:
    """Largest decrease that ends a descent."""
    return jnp.maximum(method.decrease * jnp.abs(value), _grain(value))


def _length(vector: Array) -> Array:
    return jnp.sqrt(jnp.sum(vector**2))


def _limited(method: Method, direction: Array) -> Array:
    length = _length(direction)
    return direction * jnp.minimum(1.0, method.longest / jnp.where(length > 0, length, 1.0))


def _shortened(method: Method, state: State) -> State:
    """The state once the trial is refused: a shorter step, from the same point."""
    share = state.share / 4
    length = _length(state.direction) * share
    # No direction brings more within that length, were the slope to end at its far end.
    nothing = length * _length(state.gradient) / 2 <= unseen(method, state.value)
    settled = (length < method.tolerance) | nothing
    return state._replace(
        trial=state.point + share * state.direction,
        share=share,
        converged=settled if method.backtrack else jnp.zeros((), bool),
    )


def _averaged(state: State, taken: Array) -> Array:
    """Mean of the points; a share 2 / k for the newest makes weights grow evenly with the number of the evaluation.

    Source: Shamir, Zhang 2013 (Stochastic gradient descent for non-smooth optimization), polynomial decay of order 1.
    """
    weight = jnp.minimum(2.0 / (state.index + 1).astype(state.trial.dtype), 1.0)
    return jnp.where(taken, state.average + weight * (state.trial - state.average), state.average)


__all__ = ["Info", "Method", "State", "adam", "init", "lbfgs", "step"]
