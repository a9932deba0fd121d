"""Many chains at once, from dispersed starts, and their warm-up."""

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.sharding import Mesh

from jaxest import linalg
from jaxest.filters.run import full, run
from jaxest.mcmc.kernel import collapsed, draw_theta, log_density
from jaxest.mcmc.laplace import climb
from jaxest.mcmc.model import Data, Linear, Model, Prior, Unknown, linearize, normals
from jaxest.mcmc.state import Info, Kernel, Params, State, Tuning, chosen, coordinates
from jaxest.mcmc.twist import backward, collapse, draw, fit_path, flow
from jaxest.parallel import Spread, gather, shards
from jaxest.types import Array, PyTree

_SHRINK = 20.0  # draws that a diagonal covariance counts for when the warm-up fits one
_STRIDE = 0.8  # of proposals whose density is a guess or fitted to few draws


class Chains(NamedTuple):
    """States of all chains."""

    chain: State
    """Leaves (C, ...)."""
    key: Array
    """(C,) keys, one a chain."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, iterations done."""


@cache
def step(kernel: Kernel) -> Any:
    """Make a kernel a step of `filters.run` over all chains.

    Args:
        kernel: `(params, data, state, *, key) -> (state, info)`; the same object for the same program.

    Returns:
        A step whose parameters are `(params, data)`, whose state is a `Chains`, and whose measurement is ignored.
    """
    return partial(_step, kernel)


def _step(kernel: Kernel, both: Any, chains: Chains, _: PyTree, *, key: Array | None = None) -> tuple[Chains, Info]:
    del key  # each chain has its own

    def one(state: State, key: Array) -> tuple[State, Info]:
        after, info = _alone(kernel, both, Chains(state, key, chains.index), _)
        return after.chain, info

    states, info = jax.vmap(one)(chains.chain, chains.key)
    return Chains(states, chains.key, chains.index + 1), info


def _alone(kernel: Kernel, both: Any, chain: Chains, _: PyTree, *, key: Array | None = None) -> tuple[Chains, Info]:
    """Take a step of one chain, a `Chains` without its axis."""
    del key
    params, data = both
    state, info = kernel(params, data, chain.chain, key=chain.key)
    return Chains(state, chain.key, chain.index + 1), info


def advance(
    kernel: Kernel, params: Params, data: Data, chains: Chains, iterations: int, history: Any = full,
    over: Mesh | None = None,
) -> Any:  # fmt: skip
    """Run all chains for some iterations.

    Args:
        kernel: the sampler.
        params: parameters.
        data: the series.
        chains: where they are; the same call starts, resumes, and runs in pieces that give the same draws.
        iterations: how many; static.
        history: as in `filters.run`; with `over`, of one chain's `Chains` without its axis.
        over: devices that take a share of the chains each, as `parallel.mesh` lines them up; None for one program.

    Returns:
        The chains, and the history: leaves (iterations, C, ...). Spread ones live on their devices,
        `parallel.gather` brings them to every host.
    """
    if over is None:
        return run(step(kernel), (params, data), chains, jnp.arange(iterations), history=history)
    states, kept = _shares(kernel, iterations, history, over)(params, data, chains.index, chains.chain, chains.key)
    after = Chains(states, chains.key, chains.index + iterations)
    return after, jax.tree.map(lambda x: jnp.swapaxes(x, 0, 1), kept)


@cache
def _shares(kernel: Kernel, iterations: int, history: Any, over: Mesh) -> Spread:
    """Compile the run of one device's chains once for all pieces of a run."""

    def one(params: Params, data: Data, index: Array, state: State, key: Array) -> tuple[State, Info]:
        lone = partial(_alone, kernel)
        after, info = run(lone, (params, data), Chains(state, key, index), jnp.arange(iterations), history=history)
        return after.chain, info

    return shards(one, over, common=3)


def prepare(
    kernel: Kernel, model: Model, params: PyTree, prior: Prior, data: Data, *, count: int, iterations: int,
    history: Any = full, over: Mesh,
) -> None:  # fmt: skip
    """Compile what `advance` will run, before there is any tuning: in a thread, while `warm_up` works.

    Args:
        kernel: the sampler.
        model: the model.
        params: its parameters.
        prior: the prior.
        data: the series.
        count: C, chains; static.
        iterations: of a call of `advance`; static.
        history: as in `advance`.
        over: as in `advance`.
    """

    def made(params: PyTree, prior: Prior, data: Data, key: Array) -> tuple[Params, Chains]:
        path, theta = jnp.zeros((len(data.value), model.size)), jnp.zeros(model.linear)
        linear = linearize(model, params, prior, data, path, theta)
        z = coordinates(prior.beta)
        tuning = _tuning(model, prior, data, linear, z, jnp.diag(z))
        return Params(params, prior, tuning), init(key, dispersed(model, prior, data, linear, key=key, count=count))

    given, chains = jax.eval_shape(made, params, prior, data, jax.random.key(0))
    _shares(kernel, iterations, history, over).prepare(given, data, chains.index, chains.chain, chains.key)


def init(key: Array, states: State) -> Chains:
    """Return chains at given states, leaves (C, ...), each with a key of its own."""
    count = states.index.shape[0]
    return Chains(states, jax.random.split(key, count), jnp.zeros((), jnp.int32))


@partial(jax.jit, static_argnums=0, static_argnames="count")
def dispersed(
    model: Model, prior: Prior, data: Data, linear: Linear, *, key: Array, count: int, spread: Array | float = 1.5
) -> State:
    """Return starts that lie far apart: variances within a factor exp(3) or so, paths and theta that follow them.

    Args:
        model: the model.
        prior: the variances start around its mode.
        data: the series.
        linear: what the paths follow from.
        key: random key.
        count: C, chains; static.
        spread: standard deviation of the log variances, and share of noise that the paths are given besides.

    Returns:
        States (C, ...); each path is drawn given its own variances and then roughened by as much again.
    """

    def one(key: Array) -> State:
        keys = jax.random.split(key, 4)
        mode = prior.beta / (prior.alpha + 1)
        variances = mode * jnp.exp(spread * normals(keys[0], *mode.shape))
        twist = backward(model, prior, data, linear, variances)
        given = collapse(prior, linear, twist)
        theta = given.mean + 3 * spread * (draw_theta(keys[1], given) - given.mean)
        theta = jnp.clip(theta, prior.low, prior.high)
        numbers = (1 + spread) * normals(keys[2], 1, *linear.path.shape)
        path = draw(flow(twist, linear, theta), linear, numbers)[0]
        minus = jnp.full((), -jnp.inf, mode.dtype)
        return State(path, Unknown(theta, variances), minus, jnp.zeros((), jnp.int32))

    return jax.vmap(one)(jax.random.split(key, count))


def untuned(model: Model, params: PyTree, prior: Prior, data: Data, path: Array, theta: Array) -> Tuning:
    """Linearise along the most probable path; the proposals' density is still a guess from the prior.

    Args:
        model: the model.
        params: its parameters.
        prior: the prior.
        data: the series.
        path: (T, n) from which the path is sought.
        theta: (p,) likewise.

    Returns:
        Tuning for `warm_up`.
    """
    first = Unknown(theta, prior.beta / (prior.alpha + 1))
    linear = fit_path(model, params, prior, data, first, path)
    centre = coordinates(first.variances)
    return _tuning(model, prior, data, linear, centre, jnp.diag(0.1 * centre))


@partial(jax.jit, static_argnums=0)
def _tuning(model: Model, prior: Prior, data: Data, linear: Linear, centre: Array, root: Array) -> Tuning:
    twist = backward(model, prior, data, linear, centre**-3)
    factor = collapse(prior, linear, twist).root
    eye = jnp.eye(factor.shape[0], dtype=centre.dtype)
    theta_root = linalg.solve_triangular(factor, eye, transposed=True) if len(factor) else factor
    return Tuning(linear, centre, root, jnp.full((), _STRIDE, centre.dtype), theta_root)


def warm_up(
    model: Model, params: Params, data: Data, *, key: Array, count: int = 4, iterations: int = 200, rounds: int = 2,
    over: Mesh | None = None,
) -> tuple[Params, Chains, Info]:  # fmt: skip
    """Find the tuning: Gibbs chains of the linear model from dispersed starts, linearised anew after each round.

    Needs no mode, but so few draws tell where the variances lie better than how they go together; see `settle`.

    Args:
        model: the model.
        params: parameters, tuned as `untuned` does.
        data: the series.
        key: random key.
        count: chains; static.
        iterations: of each round, of which the first third is not looked at; static.
        rounds: how often; static.
        over: as in `advance`.

    Returns:
        Parameters with the tuning found, the chains' last states, and their history in the last round.
    """
    kernel = collapsed(model)
    keys = jax.random.split(key, rounds + 1)
    states = dispersed(model, params.prior, data, params.tuning.linear, key=keys[-1], count=count)
    chains, history = init(keys[0], states), None
    for i in range(rounds):
        chains = init(keys[i], chains.chain)
        chains, history = advance(kernel, params, data, chains, iterations, over=over)
        # What lives on several devices would have every program of the fit compiled once more.
        chains, history = (chains._replace(chain=_here(chains.chain)), _here(history)) if over else (chains, history)
        params = params._replace(tuning=_refit(model, params, data, history, iterations // 3))
    assert history is not None
    return params, chains, history


def settle(model: Model, params: Params, data: Data, rounds: int = 2) -> tuple[Params, bool]:
    """Find the tuning without drawing anything: the mode and the curvature of the linear model's density of variances.

    Args:
        model: the model.
        params: parameters, tuned as `untuned` does.
        data: the series.
        rounds: how often the mode is sought, the model linearised anew in between; static.

    Returns:
        Parameters with the tuning found, and whether there was a mode to find; `warm_up` does without.
    """
    for i in range(rounds):
        tuning, found = _curved(model, params, data)
        if not found:
            return params, False
        linear = tuning.linear
        if i < rounds - 1:
            first = Unknown(jnp.clip(linear.centre, params.prior.low, params.prior.high), tuning.centre**-3)
            linear = fit_path(model, params.model, params.prior, data, first, linear.path, 4)
            scale = jnp.diag(jnp.sqrt(jnp.sum(tuning.root**2, axis=1)))
            params = params._replace(tuning=tuning._replace(linear=linear, root=scale))
    final = _tuning(model, params.prior, data, linear, tuning.centre, tuning.root)
    return params._replace(tuning=final._replace(stride=tuning.stride)), True


@partial(jax.jit, static_argnums=0)
def _curved(model: Model, params: Params, data: Data) -> tuple[Tuning, Array]:
    """Take the proposals' density from the curvature at the mode; proposals then draw all of z anew."""
    tuning = params.tuning
    scale = jnp.sqrt(jnp.sum(tuning.root**2, axis=1))
    found = climb(partial(log_density, model, params, data), tuning.centre, scale)
    new = tuning._replace(centre=found.mean, root=found.root, stride=jnp.ones_like(tuning.stride))
    return chosen(found.good, new, tuning), found.good


def _here(tree: PyTree) -> PyTree:
    return jax.tree.map(jnp.asarray, gather(tree))


def _refit(model: Model, params: Params, data: Data, history: Info, discard: int) -> Tuning:
    first, root = _fitted(params.prior, history.unknown, discard)
    linear = fit_path(model, params.model, params.prior, data, first, params.tuning.linear.path, 4)
    return _tuning(model, params.prior, data, linear, coordinates(first.variances), root)


@partial(jax.jit, static_argnums=2)
def _fitted(prior: Prior, drawn: Unknown, discard: int) -> tuple[Unknown, Array]:
    """Return the centre of draws (iterations, C, ...) and a root of the covariance of z, in one program."""
    draws = (drawn.theta.shape[0] - discard) * drawn.theta.shape[1]
    unknown = jax.tree.map(lambda x: x[discard:].reshape(draws, x.shape[-1]), drawn)
    theta = jnp.clip(jnp.mean(unknown.theta, axis=0), prior.low, prior.high)
    z = coordinates(unknown.variances)
    centre = jnp.mean(z, axis=0)
    away = z - centre[None]
    weight = draws / 10  # of the Gibbs sampler's draws, so many count as independent
    covariance = away.T @ away / draws
    covariance = (weight * covariance + _SHRINK * jnp.diag(jnp.diagonal(covariance))) / (weight + _SHRINK)
    return Unknown(theta, centre**-3), linalg.cholesky(covariance)


__all__ = ["Chains", "advance", "dispersed", "init", "prepare", "settle", "step", "untuned", "warm_up"]
