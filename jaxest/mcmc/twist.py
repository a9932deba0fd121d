"""The backward information filter of a linear model: what the data still to come say of each state.

psi[t](x) = p(y[t], y[t+1], ... | x[t] = x, theta) of the linear model is kept as the matrix A of
-(z' A z) / 2 with z = (x - path, 1, theta - centre), so that one pass serves every theta and gives the evidence as a
quadratic in theta. A step eliminates the noise of a state by Cholesky factors, which also draw that state.

Source: the twisting of particle filters, Whiteley and Lee 2014; the two-filter form, Briers, Doucet and Maskell 2010.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product
from jaxest.mcmc._information import carried, eliminate, noises, precisions
from jaxest.mcmc._information import measured as measured_by
from jaxest.mcmc.model import Data, Linear, Model, Prior, Unknown, linearize
from jaxest.types import Array, PyTree


class Twist(NamedTuple):
    """Row t belongs to state t, k = n + 1 + p."""

    root: Array
    """(T, n, n) L, lower triangular: L L' is the precision of state t given the one before and all data from t on."""
    inverse: Array
    """(T, n, n) of L."""
    link: Array | None
    """(T, n, k) W = L^-1 A: `L' u + W z` is standard normal for the noise u of state t, z taken at its prediction; None
    where nothing is known of the data: it, `here` and `ahead` are zero then."""
    here: Array | None
    """(T, k, k) A of psi[t], at state t; None where whole paths are drawn, which has no need of it."""
    ahead: Array | None
    """(T, k, k) A of psi[t] integrated over the noise of state t, at its prediction; or None."""
    here_log: Array
    """(T,) logarithm of psi[t] where z' A z is 0."""
    ahead_log: Array
    """(T,) likewise, of the integrated one."""
    evidence: Array
    """(1 + p, 1 + p) E: the log-evidence is `evidence_log - (1, theta - centre) E (1, theta - centre)' / 2`."""
    evidence_log: Array
    """()"""


class Collapsed(NamedTuple):
    """theta given the variances, in the linear model without the box: normal."""

    mean: Array
    """(p,)"""
    root: Array
    """(p, p) lower triangular root of the precision."""
    log_evidence: Array
    """() of the variances, theta integrated out (flat, without the box)."""


def backward(model: Model, prior: Prior, data: Data, linear: Linear, variances: Array, whole: bool = False) -> Twist:
    """Run the backward information filter.

    Args:
        model: the model.
        prior: for the first state.
        data: the series.
        linear: the linear model.
        variances: (n + m,).
        whole: whether to keep `here` and `ahead` too; static.

    Returns:
        What each state's proposal and the evidence need.
    """
    precision, log_det = precisions(model, prior, variances, linear.path.shape[0])
    return sweep(linear, *measured_by(model, linear, data, variances), precision, log_det, whole)


def sweep(
    linear: Linear, measured: Array, measured_log: Array, precision: Array, log_det: Array, whole: bool = False
) -> Twist:
    """Run the backward information filter on given information.

    Args:
        linear: the linear model.
        measured: (T, k, k) A of each measurement alone.
        measured_log: (T,) its logarithm where z' A z is 0.
        precision: (T, n, n) of each state's noise; the first is that of its prior.
        log_det: (T,) logarithm of its determinant.
        whole: as in `backward`; static.

    Returns:
        As `backward`.
    """
    n = linear.path.shape[1]

    def retreat(carry: tuple[Array, Array], now: Any) -> tuple[Any, Any]:
        a, log = carry
        of_data, of_data_log, precision, log_det, top = now
        here, here_log = a + of_data, log + of_data_log
        factors, ahead, gain = eliminate(here, precision, log_det)
        ahead_log = here_log + gain
        kept = (here, ahead) if whole else (None, None)
        return (carried(ahead, top), ahead_log), (*factors, *kept, here_log, ahead_log)

    start = (jnp.zeros_like(measured[0]), jnp.zeros_like(measured_log[0]))
    top = jnp.concatenate([linear.jacobian, linear.offset[:, :, None], linear.design], axis=2)
    xs = (measured, measured_log, precision, log_det, top)
    (last, log), rows = jax.lax.scan(retreat, start, xs, reverse=True)
    return Twist._make((*rows, last[n:, n:], log))


def next_only(model: Model, prior: Prior, data: Data, linear: Linear, variances: Array) -> Twist:
    """Look at the next measurement only, as fully adapted particles do; arguments as in `backward`, always whole."""
    here, log = measured_by(model, linear, data, variances)
    given = precisions(model, prior, variances, linear.path.shape[0])
    factors, ahead, gain = jax.vmap(eliminate)(here, *given)
    unknown = _unknown(model, here.dtype)
    return Twist(*factors, here, ahead, log, log + gain, unknown, unknown[0, 0])


def nothing(model: Model, prior: Prior, data: Data, linear: Linear, variances: Array) -> Twist:
    """Look at no measurement to come, as bootstrap particles do; arguments as in `backward`."""
    del data
    sd = jnp.sqrt(noises(model, prior, variances, linear.path.shape[0]))
    none = jnp.zeros_like(sd[:, 0])
    unknown = _unknown(model, sd.dtype)
    return Twist(
        jax.vmap(jnp.diag)(1 / sd), jax.vmap(jnp.diag)(sd), None, None, None, none, none, unknown, unknown[0, 0]
    )


def _unknown(model: Model, dtype: Any) -> Array:
    return jnp.full((1 + model.linear, 1 + model.linear), jnp.nan, dtype)


def log_evidence(twist: Twist, linear: Linear, theta: Array) -> Array:
    """Return the linear model's log p(y | theta, variances) ()."""
    z = jnp.concatenate([jnp.ones(1, theta.dtype), theta - linear.centre])
    return twist.evidence_log - z @ twist.evidence @ z / 2


def collapse(prior: Prior, linear: Linear, twist: Twist) -> Collapsed:
    """Return theta given the variances, and the evidence without theta.

    Args:
        prior: a millionth of the information of a normal as wide as its box stands in for what the data leave open.
        linear: the linear model.
        twist: of the variances.

    Returns:
        The normal density; use it as a proposal, since it knows no box.
    """
    if not len(linear.centre):
        return Collapsed(linear.centre, jnp.zeros((0, 0)), twist.evidence_log - twist.evidence[0, 0] / 2)
    wide = jnp.where(jnp.isfinite(prior.high - prior.low), prior.high - prior.low, 1e6)
    information = twist.evidence[1:, 1:] + jnp.diag(1e-6 / wide**2)
    root = linalg.cholesky(information)
    white = linalg.solve_triangular(root, -twist.evidence[1:, 0])
    mean = linalg.solve_triangular(root, white, transposed=True)
    log = twist.evidence_log - twist.evidence[0, 0] / 2 + jnp.sum(white * white) / 2
    log = log - jnp.sum(jnp.log(jnp.diagonal(root))) + len(white) * jnp.log(2 * jnp.pi) / 2
    return Collapsed(linear.centre + mean, root, log)


class Flow(NamedTuple):
    """The linear model given the data, forward in time: x[t] = gain x[t-1] + offset + root standard normal."""

    gain: Array
    """(T, n, n)"""
    offset: Array
    """(T, n)"""
    root: Array
    """(T, n, n), inverse transposed of the twist's root."""
    left: Array
    """(T, n, n) what is left of a change of state t's prediction once the data are known."""


def flow(twist: Twist, linear: Linear, theta: Array) -> Flow:
    """Return how states follow each other given all data, in deviations from the linear model's path.

    Raises:
        ValueError: the twist is that of `nothing`.
    """
    n = linear.path.shape[1]
    root = jnp.swapaxes(twist.inverse, 1, 2)
    back = product(root, _link(twist))
    left = jnp.eye(n, dtype=theta.dtype)[None] - back[:, :, :n]
    away = theta - linear.centre
    shift = linear.offset + jnp.einsum("tip,p->ti", linear.design, away)
    offset = jnp.einsum("tij,tj->ti", left, shift) - back[:, :, n] - jnp.einsum("tip,p->ti", back[:, :, n + 1 :], away)
    return Flow(product(left, linear.jacobian), offset, root, left)


def _link(twist: Twist) -> Array:
    if twist.link is None:
        raise ValueError("twist: got one that knows nothing of the data, expected one of `backward` or `next_only`")
    return twist.link


def draw(given: Flow, linear: Linear, normal: Array, moved: Array | None = None) -> Array:
    """Turn standard normal numbers (N, T, n) into paths (N, T, n) of the linear model given the data.

    Args:
        given: how states follow each other.
        linear: the linear model.
        normal: (N, T, n).
        moved: (N, T - 1, n) by how much each path's predictions of states 1 ... are moved first; by nothing if None.

    Returns:
        (N, T, n)
    """
    noise = jnp.einsum("tij,Ntj->tNi", given.root, normal) + given.offset[:, None]
    if moved is not None:
        noise = noise.at[1:].add(jnp.einsum("tij,Ntj->tNi", given.left[1:], moved))

    def advance(x: Array, now: tuple[Array, Array]) -> tuple[Array, Array]:
        gain, noise = now
        x = product(x, gain.T) + noise
        return x, x

    away = jax.lax.scan(advance, jnp.zeros_like(noise[0]), (given.gain, noise))[1]
    return jnp.swapaxes(away, 0, 1) + linear.path[None]


def whiten(twist: Twist, linear: Linear, theta: Array, path: Array) -> Array:
    """Return the standard normal numbers (T, n) of which `draw` makes a path (T, n).

    Raises:
        ValueError: the twist is that of `nothing`.
    """
    link = _link(twist)
    away = path - linear.path
    before = jnp.concatenate([jnp.zeros_like(away[:1]), away[:-1]])
    shift = theta - linear.centre
    ahead = jnp.einsum("tij,tj->ti", linear.jacobian, before) + linear.offset
    ahead = ahead + jnp.einsum("tip,p->ti", linear.design, shift)
    n = away.shape[1]
    mixed = jnp.einsum("tij,tj->ti", link[:, :, :n], ahead) + link[:, :, n]
    mixed = mixed + jnp.einsum("tip,p->ti", link[:, :, n + 1 :], shift)
    return jnp.einsum("tji,tj->ti", twist.root, away - ahead) + mixed


def fit_path(
    model: Model, params: PyTree, prior: Prior, data: Data, first: Unknown, path: Array, iterations: int = 8
) -> Linear:
    """Find the most probable path with theta at its best, and linearise there: the iterated smoother, theta with it.

    Two small programs are called in turn, so that each is compiled once for all uses.

    Args:
        model: the model.
        params: its parameters.
        prior: the prior; the box is not looked at.
        data: the series.
        first: theta to start from, and the variances.
        path: (T, n) to start from.
        iterations: Gauss-Newton steps.

    Returns:
        The linear model along that path.

    Source: Bell 1994 (The iterated Kalman smoother as a Gauss-Newton method).
    """
    theta = first.theta
    for _ in range(iterations):
        linear = _linearize(model, params, prior, data, path, theta)
        path, theta = _better(model, prior, data, linear, first.variances)
    return _linearize(model, params, prior, data, path, theta)


_linearize = jax.jit(linearize, static_argnums=0)


@partial(jax.jit, static_argnums=0)
def _better(model: Model, prior: Prior, data: Data, linear: Linear, variances: Array) -> tuple[Array, Array]:
    """Return the most probable path and theta of a linear model."""
    twist = backward(model, prior, data, linear, variances)
    theta = collapse(prior, linear, twist).mean
    return draw(flow(twist, linear, theta), linear, jnp.zeros_like(linear.path)[None])[0], theta


__all__ = ["Collapsed", "Flow", "Twist", "backward", "collapse", "draw", "fit_path", "flow", "log_evidence",
           "next_only", "nothing", "sweep", "whiten"]  # fmt: skip
