"""A proposal that looks at the measurement first: each particle's own Gaussian about its most probable next state."""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.filters.particle import _cholesky
from jaxest.filters.particle import _draws as draws
from jaxest.filters.particle import _gauss_newton as gauss_newton
from jaxest.filters.particle._draws import Plan
from jaxest.filters.particle._gauss_newton import Prior
from jaxest.filters.particle.proposal import LogLikelihood, Rows, densities, each
from jaxest.filters.particle.transition import Opening, Transition, direct
from jaxest.filters.resampling import normalize
from jaxest.manifolds.base import Manifold
from jaxest.types import Array, ArrayLike, PyTree

OPENING = 8  # Gauss-Newton steps of the first step, which may have far to go
SCATTER = 1.2  # rad, how far from the law's centre every second search of that step may start
FAR, ASIDE = 1.0, 4  # one particle of so many does not heed a guess so far away, as it may stand rightly
MANY = 6  # dimensions above which proposals are curved
REACH = 2.5  # rad, as far as a mode may lie where noise ends at half a turn
SHARE = 0.01  # of the choice of ancestors that pays no heed to what was foreseen: no weight grows more than 100 times


class Guided(NamedTuple):
    """The proposal `guided` makes. Call it, or `look` ahead, choose who goes on, and `send`."""

    manifold: Manifold
    transition: Transition
    log_likelihood: LogLikelihood
    rows: Rows
    iterations: int
    defensive: float
    curved: bool

    def __call__(self, params: PyTree, particles: PyTree, measurement: PyTree, key: Array) -> tuple[PyTree, Array]:
        """Send each particle on; see `Proposal`."""
        _, plan = self.look(params, particles, measurement)
        return self.send(params, particles, plan, measurement, key)

    def look(
        self, params: PyTree, particles: PyTree, measurement: PyTree, first: ArrayLike = False
    ) -> tuple[Array, Plan]:
        """Find each particle's Gaussian.

        Args:
            params: the filter's.
            particles: leaves (N, ...).
            measurement: of this step.
            first: () whether this is the first step, where the law of the first state may be used.

        Returns:
            (N,) the logarithm of how likely each particle makes the measurement, but for what all share, roughly, for
            `heeded`; and the plan, which `take` reduces to those that go on.
        """
        fixed, seen, particles = jax.lax.stop_gradient((params, measurement, particles))
        begins = jnp.asarray(first, bool)
        centre, prior = _prior(self, fixed, particles, seen, begins)
        turns: ArrayLike = self.iterations
        if self.transition.opening is not None:
            turns = jnp.where(begins, max(OPENING, self.iterations), self.iterations)
        given = (fixed, centre, seen)
        bounded = np.broadcast_to(self.transition.bounded, (self.manifold.dim,))
        reach = np.where(bounded, REACH, math.inf)
        equations, factor, mode, energy = gauss_newton.posterior(self.manifold, self.rows, given, prior, turns, reach)
        basis, wide = gauss_newton.split(equations) if self.curved else (None, None)
        if basis is not None:
            factor = gauss_newton.factorized(equations, basis, prior)
            mode = gauss_newton.within(_cholesky.solve(factor, factor[:, -1]), reach)
        numbers = jnp.arange(factor.shape[0])
        ahead = -energy / 2 - jnp.sum(jnp.log(factor[numbers, numbers]), axis=0)  # the integral of each Gaussian
        plan = Plan(centre, mode, factor, basis, wide, prior, begins, jnp.zeros((), bool))
        opening = self.transition.opening
        if opening is None or opening.scattered is None:
            return ahead, plan
        plan = plan._replace(scattered=begins & opening.scattered(fixed, seen))
        return draws.seldom(
            plan.scattered, partial(self._worth, opening), (fixed, particles, plan, seen), ahead
        ), plan  # fmt: skip

    def _worth(self, opening: Opening, params: PyTree, particles: PyTree, plan: Plan, measurement: PyTree) -> Array:
        """How likely the measurement is about each mode, by exact densities: a search from afar need not have ended."""
        aims, numbers = self.aims(plan), jnp.arange(plan.factor.shape[0])
        found = each(self.log_likelihood)(params, aims, measurement)
        noise = jnp.zeros_like(plan.mode.T)
        found = found + jax.vmap(opening.log_prob, (None, 0, 0, 0, None))(params, particles, aims, noise, measurement)
        return found - jnp.sum(jnp.log(plan.factor[numbers, numbers]), axis=0)

    def heeded(self, ahead: Array, log_weights: Array) -> Array:
        """Return by how much to favour each particle, in the choice of who goes on.

        Args:
            ahead: (N,) as `look` foresees it, logarithms of any scale.
            log_weights: (N,) of the particles, their exponentials sum to one.

        Returns:
            (N,) logarithms of factors; weights times these sum to one, too. A share of the choice is made by the
            weights alone, so that a particle whose worth was not foreseen cannot come to weigh a lot: at least the
            defensive share, as what only a draw from the transition finds is not foreseen at all.
        """
        share = max(SHARE, self.defensive)
        _, total, vanished = normalize(log_weights + ahead)
        own = jnp.where(jnp.isfinite(ahead) & ~vanished, ahead - jnp.where(vanished, 0, total), -jnp.inf)
        mixed = jnp.logaddexp(math.log1p(-share) + own, math.log(share))
        return jax.lax.stop_gradient(jnp.where(vanished, 0, mixed))

    def aims(self, plan: Plan) -> PyTree:
        """Return each particle's most probable next state, leaves (N, ...)."""
        noise = (
            plan.mode if plan.basis is None else jnp.matmul(plan.basis, plan.mode, precision=jax.lax.Precision.HIGHEST)
        )
        return jax.vmap(self.manifold.retract, (0, 1))(plan.centre, noise)

    def send(
        self, params: PyTree, particles: PyTree, plan: Plan, measurement: PyTree, key: Array,
        log_weights: Array | None = None,
    ) -> tuple[PyTree, Array]:  # fmt: skip
        """Draw from the Gaussians of those who go on.

        Args:
            params: the filter's.
            particles: leaves (N, ...), those who go on.
            plan: theirs.
            measurement: of this step.
            key: random key.
            log_weights: (N,) of those who go on; equal if None.

        Returns:
            The new particles, leaves (N, ...), and the logarithms (N,) of likelihood times transition density over the
            density of the draw; where the plan is scattered, over that of all draws together, whoever was favoured in
            the choice.
        """
        fixed, seen, particles = jax.lax.stop_gradient((params, measurement, particles))
        white = draws.normals(key, plan.mode)
        if plan.basis is None or plan.wide is None:
            noise, drawn = draws.straight(plan, white)
        else:
            noise, drawn = jax.lax.cond(
                plan.scattered,
                partial(draws.turned, plan, plan.basis),
                partial(draws.bent, self.manifold, self.rows, (fixed, plan.centre, seen), plan, plan.basis, plan.wide),
                white,
            )
        if self.defensive:
            noise = draws.mixed(self.transition, self.defensive, fixed, seen, noise, key)
        noise = jax.lax.stop_gradient(noise)
        moved = jax.lax.stop_gradient(jax.vmap(self.manifold.retract)(plan.centre, noise))
        density = _densities(self, plan, params, particles, moved, noise, measurement)
        if self.defensive:
            white = _cholesky.whiten(plan.factor, noise.T - plan.mode)
            own = jnp.log1p(-self.defensive) + draws.log_normal(plan.factor, white)
            drawn = jnp.logaddexp(own, jnp.log(self.defensive) + density)
        opening = self.transition.opening
        if opening is not None and opening.scattered is not None:
            equal = jnp.zeros_like(drawn) if log_weights is None else log_weights
            every = partial(draws.together, self.manifold)
            drawn = draws.seldom(plan.scattered, every, (plan, moved, jax.lax.stop_gradient(equal)), drawn)
        weight = each(self.log_likelihood)(params, moved, measurement)
        return moved, weight + density - jax.lax.stop_gradient(drawn)


def guided(
    manifold: Manifold,
    transition: Transition,
    log_likelihood: LogLikelihood,
    rows: Rows,
    *,
    iterations: int = 2,
    defensive: float = 0.0,
    curved: bool | None = None,
) -> Guided:
    """Draw each particle from a Gaussian about its own most probable next state, found by Gauss-Newton.

    The Gaussian lives in the tangent space at the transition's mean, with information `Q^-1 + J'J`. A residual that is
    not finite leaves that particle the transition's own Gaussian. Draws come in pairs, one on either side of the mode,
    so that the mean of all hardly scatters.

    A filter chooses who goes on by how likely a particle makes the new measurement, as its Gaussian foresees it, and
    takes that out of the weights again, which are exact: a fully adapted filter where all is linear.

    Where the measurement fits several states within reach of the transition's noise (a position alone, say), each
    particle goes to one of them; weights are exact, but states that no particle visits are missed, in the evidence
    too, and nothing shows it. A defensive share is the remedy: it draws that share from the transition, and lets as
    many go on whatever was foreseen of them, so that no weight then exceeds likelihood / share^2.

    Args:
        manifold: where the state lives, dimension d.
        transition: how it moves; its `guess` and `opening` are used.
        log_likelihood: `(params, x, measurement) -> ()`, exact, for the weights.
        rows: `(params, x, measurement) -> (m,), (m, d)`, linearised, for the proposal; `differentiated` makes them
            from the residuals alone.
        iterations: Gauss-Newton steps, static. One is enough where the measurement is close to linear over the
            transition's noise. The first step takes more where the transition has an opening.
        defensive: share of the particles that are drawn from the transition instead, static; all are weighed against
            the mixture. Costs about that share of the effective sample size where there is one mode. The opening is
            left alone then, and nothing is curved.
        curved: whether the directions of which the measurement says little are drawn first, and the others about where
            that leads, by linearising once more there; static. Where d is above 6 if None: many sensors that each bend
            a little over these directions waste most of the particles otherwise.

    Returns:
        The proposal.

    Raises:
        ValueError: `iterations` below 1, or `defensive` outside [0, 1).

    Source: Pitt and Shephard 1999 (Filtering via simulation: auxiliary particle filters) for the choice; Hesterberg
    1995 (Weighted average importance sampling and defensive mixture distributions) for the mixture.
    """
    if iterations < 1:
        raise ValueError(f"iterations: got {iterations}, expected at least 1")
    if not 0 <= defensive < 1:
        raise ValueError(f"defensive: got {defensive}, expected a share from 0 to below 1")
    if defensive:
        transition = transition._replace(opening=None)
    bent = manifold.dim > MANY if curved is None else curved
    return Guided(manifold, transition, log_likelihood, rows, iterations, float(defensive), bent and not defensive)


def take(plan: Plan, ancestors: Array) -> Plan:
    """Return the plan (N) of those who go on, ancestors (N,)."""
    first, last = partial(picked, ancestors), partial(picked, ancestors, axis=-1)
    prior = plan.prior._replace(**{name: last(getattr(plan.prior, name)) for name in ("start", "pull", "energy")})
    return plan._replace(
        centre=jax.tree.map(first, plan.centre), mode=last(plan.mode), factor=last(plan.factor), prior=prior
    )


def picked(ancestors: Array, x: Array, axis: int = 0) -> Array:
    """Return what an array has of the ancestors, which lie within it: checks would cost as much as the rest."""
    index = (slice(None),) * (axis % x.ndim) + (ancestors,)
    return x.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def _prior(ours: Guided, params: PyTree, particles: PyTree, seen: PyTree, begins: Array) -> tuple[PyTree, Prior]:
    """Where each particle's tangent space is taken, and the Gaussian there before the measurement."""
    size, (leaf, *_) = ours.manifold.dim, jax.tree.leaves(particles)
    count, dtype = leaf.shape[0], leaf.dtype
    none = jnp.zeros((size, count), dtype)
    transition, opening = ours.transition, ours.transition.opening

    def usual() -> tuple[PyTree, Prior]:
        precision = jnp.asarray(transition.precision(params, seen), dtype)
        if precision.shape not in ((size,), (size, size)):
            raise ValueError(f"precision: has shape {precision.shape}, expected ({size},) or ({size}, {size})")
        diagonal = precision.ndim == 1
        full = jnp.diag(precision) if diagonal else precision
        covariance = jnp.diag(1 / precision) if diagonal else linalg.inverse(precision)
        return each(transition.mean)(params, particles, seen), Prior(none, full, covariance, none, none[0])

    def anew(opening: Opening) -> tuple[PyTree, Prior]:
        centre = each(opening.centre)(params, particles, seen)
        mean = jax.vmap(ours.manifold.local)(centre, each(opening.mean)(params, particles, seen)).T
        precision = jnp.asarray(opening.precision(params, seen), dtype)
        pull = precision[:, None] * mean
        # Every second search starts elsewhere: one that starts where encoders say ends in a wrong posture where the
        # robot is bent by a rad. What is found so does not hang on the run's key.
        aside = SCATTER * jax.random.uniform(jax.random.key(0), (size, count), dtype, -1, 1)
        begun = jnp.where(jnp.arange(count)[None] % 2 == 1, aside, 0)
        prior = Prior(begun, jnp.diag(precision), jnp.diag(1 / precision), pull, jnp.sum(mean * pull, axis=0))
        return centre, prior

    centre, prior = usual() if opening is None else jax.lax.cond(begins, partial(anew, opening), usual)
    if transition.guess is None:
        return centre, prior
    start = each(transition.guess)(params, centre, seen).astype(dtype).T
    heeds = begins | (jnp.arange(count) % ASIDE != 0) | (jnp.max(jnp.abs(start), axis=0) < FAR)
    return centre, prior._replace(start=prior.start + jnp.where(heeds[None], start, 0))


def _densities(
    ours: Guided, plan: Plan, params: PyTree, particles: PyTree, moved: PyTree, noise: Array, measurement: PyTree
) -> Array:
    """Log-densities (N,) of the new particles, before the measurement."""
    opening = ours.transition.opening

    def usual() -> Array:
        return densities(ours.manifold, ours.transition, params, particles, moved, noise, measurement)

    if opening is None:
        return usual()

    def anew() -> Array:
        drawn = jax.vmap(opening.log_prob, (None, 0, 0, 0, None))(params, particles, moved, noise, measurement)
        # As for a transition: a draw that has gone round weighs nothing, the same state is drawn the short way.
        way = jax.lax.stop_gradient(jax.vmap(ours.manifold.local)(plan.centre, moved))
        return jnp.where(jax.vmap(partial(direct, ours.transition))(way, noise), drawn, -jnp.inf)

    density: Array = jax.lax.cond(plan.first, anew, usual)
    return density


__all__ = ["Guided", "Plan", "guided", "take"]
