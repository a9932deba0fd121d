"""Other samplers of the torque benchmark: the paper's in NumPy, `particles`' Gibbs sampler, `blackjax`' NUTS.

The dynamics of the first two are MuJoCo's, all particles at once on all cores: NumPy alone would be slower.
"""

import importlib
import time
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.mcmc.kernel import Params
from jaxest.mcmc.model import Data, Model, Prior, Unknown, log_prior
from jaxest.mcmc.twist import backward, log_evidence
from jaxest.parallel import several, shards

Rows = NDArray[np.float64]
THREADS = 2
LEAST = 8  # iterations whose chains can still be split


class Draws(NamedTuple):
    """What a sampler has drawn."""

    theta: Rows
    """(C, S, n) N m"""
    variances: Rows
    """(C, S, 3 n)"""
    path: Rows
    """(C, S, T) sum of the angles at each time, by which the path is judged; T = 0 where there is none"""
    seconds: float
    """that the S iterations of all chains took, compilation and warm-up left out"""


class Problem(NamedTuple):
    """The posterior, as NumPy has it."""

    model: Any
    """compiled by MuJoCo, its timestep that of the series"""
    value: Rows
    """(T, n) rad, nothing missing"""
    prior: Any
    """a `Prior` with NumPy arrays"""
    accelerations: Callable[[Rows, Rows], Rows]
    """`(states (N, 2 n), torques (n,)) -> (N, n)`"""


def problem(model: Any, data: Data, prior: Prior) -> Problem:
    """Set a posterior up for NumPy.

    Args:
        model: the robot, compiled by MuJoCo: hinges without damping.
        data: series with even steps, no known torque and nothing missing.
        prior: the prior.
    """
    model.opt.timestep = float(data.inputs.dt[0])
    return Problem(model, np.asarray(data.value), jax.tree.map(np.asarray, prior), _accelerations(model))


def _accelerations(model: Any) -> Callable[[Rows, Rows], Rows]:
    """MuJoCo's steps on all cores, of which the change of speed is what is wanted."""
    import mujoco
    from mujoco.rollout import Rollout

    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    force = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
    pool, data = Rollout(nthread=THREADS), [mujoco.MjData(model) for _ in range(THREADS)]
    n = model.nv

    def accelerations(x: Rows, tau: Rows) -> Rows:
        first = np.zeros((len(x), size))
        first[:, 1 : 1 + 2 * n] = x
        torques = np.broadcast_to(tau, (len(x), 1, n)).copy()
        after = pool.rollout(model, data, first, torques, control_spec=force)[0][:, 0]
        found: Rows = (after[:, 1 + n : 1 + 2 * n] - x[:, n:]) / model.opt.timestep
        return found

    return accelerations


def ahead(given: Problem, x: Rows, tau: Rows) -> Rows:
    """Return next states (N, 2 n) without noise.

    Source: Zakeri 2023, eqs. 12 and 13.
    """
    n, h = given.model.nv, given.model.opt.timestep
    return np.concatenate([x[:, :n] + h * x[:, n:], x[:, n:] + h * given.accelerations(x, tau)], axis=1)


def paper(given: Problem, starts: Any, seconds: float, count: int = 1000, seed: int = 0) -> Draws:
    """Run the paper's particle Gibbs sampler, all chains in turn.

    Args:
        given: the posterior.
        starts: states of the chains, as `mcmc.chains` has them.
        seconds: how long; at least 8 iterations are made.
        count: N, particles.
        seed: of the random numbers.

    Source: Zakeri 2023, section 4; eq. 25 with the S2^-1 that it omits.
    """
    random = np.random.default_rng(seed)
    chains = range(len(starts.path))
    now = [tuple(np.asarray(x[chain]) for x in (starts.path, *starts.unknown)) for chain in chains]
    kept: list[Any] = []
    begun = time.perf_counter()
    while len(kept) < LEAST or time.perf_counter() - begun < seconds:
        for chain, (path, tau, s) in enumerate(now):
            path = _conditional(random, given, path, tau, s, count)
            now[chain] = (path, *unknowns(random, given, path, tau, s))
        kept.append([(tau, s, path[:, : given.model.nv].sum(axis=1)) for path, tau, s in now])
    took = time.perf_counter() - begun
    theta, variances, paths = (np.array([[one[k] for one in rows] for rows in kept]).swapaxes(0, 1) for k in range(3))
    return Draws(theta, variances, paths, took)


def _conditional(random: np.random.Generator, given: Problem, path: Rows, tau: Rows, s: Rows, count: int) -> Rows:
    """Draw a path by conditional SMC with bootstrap particles."""
    steps, n = given.value.shape
    x = given.prior.mean + np.sqrt(given.prior.variance) * random.normal(size=(count, 2 * n))
    x[0] = path[0]
    kept, parents = [x], []
    for t in range(steps):
        log = -0.5 * ((given.value[t] - x[:, :n]) ** 2 / s[2 * n :]).sum(axis=1)
        weights = np.exp(log - log.max())
        weights /= weights.sum()
        if t == steps - 1:
            break
        parent = random.choice(count, count, p=weights)
        parent[0] = 0
        x = ahead(given, x[parent], tau) + np.sqrt(s[: 2 * n]) * random.normal(size=x.shape)
        x[0] = path[t + 1]
        kept.append(x)
        parents.append(parent)
    at = random.choice(count, p=weights)
    found = [kept[-1][at]]
    for x, parent in zip(reversed(kept[:-1]), reversed(parents), strict=True):
        at = parent[at]
        found.append(x[at])
    return np.stack(found[::-1])


def unknowns(random: np.random.Generator, given: Problem, path: Rows, tau: Rows, s: Rows) -> tuple[Rows, Rows]:
    """Draw torques and variances given a path (T, 2 n).

    Source: Zakeri 2023, eqs. 25 to 31.
    """
    import mujoco
    from scipy.stats import truncnorm

    n, h, prior = given.model.nv, given.model.opt.timestep, given.prior
    data, full = mujoco.MjData(given.model), np.zeros((n, n))
    slope = np.empty((len(path) - 1, n, n))
    for t, x in enumerate(path[:-1]):
        data.qpos[:], data.qvel[:] = x[:n], x[n:]
        mujoco.mj_forward(given.model, data)
        mujoco.mj_fullM(given.model, data, full)
        slope[t] = h * np.linalg.inv(full)
    left = path[1:] - ahead(given, path[:-1], tau)
    precision = np.einsum("tip,i,tiq->pq", slope, 1 / s[n : 2 * n], slope)
    right = np.einsum("tip,i,ti->p", slope, 1 / s[n : 2 * n], left[:, n:])
    mean, found = tau + np.linalg.solve(precision, right), np.array(tau)
    for i in range(n):
        sd = 1 / np.sqrt(precision[i, i])
        centre = found[i] - precision[i] @ (found - mean) / precision[i, i]
        low, high = (prior.low[i] - centre) / sd, (prior.high[i] - centre) / sd
        found[i] = np.clip(truncnorm.rvs(low, high, centre, sd, random_state=random), prior.low[i], prior.high[i])
    left[:, n:] -= np.einsum("tip,p->ti", slope, found - tau)
    squares = np.concatenate([(left**2).sum(axis=0), ((given.value - path[:, :n]) ** 2).sum(axis=0)])
    counts = np.repeat([len(path) - 1, len(path)], [2 * n, n])
    return found, (prior.beta + squares / 2) / random.gamma(prior.alpha + counts / 2)


def particles_gibbs(mcmc: Any, given: Problem, starts: Any, seconds: float, count: int = 1000) -> Draws:
    """Run the Gibbs sampler of the package `particles`, chain after chain.

    Args:
        mcmc: the module `particles.mcmc`.
        given: the posterior.
        starts: states of the chains; only torques and variances can be given to it.
        seconds: how long; 8 iterations of the first chain tell how many are made.
        count: N, particles.
    """
    distributions: Any = importlib.import_module("particles.distributions")
    base: Any = importlib.import_module("particles.state_space_models").StateSpaceModel
    n = given.value.shape[1]
    random = np.random.default_rng(0)
    paths: list[Rows] = []

    class Arm(base):
        def PX0(self) -> Any:
            return distributions.MvNormal(given.prior.mean, np.sqrt(given.prior.variance))

        def PX(self, t: int, xp: Rows) -> Any:
            return distributions.MvNormal(ahead(given, xp, self.tau), np.sqrt(self.s[: 2 * n]))

        def PY(self, t: int, xp: Rows, x: Rows) -> Any:
            return distributions.MvNormal(x[:, :n], np.sqrt(self.s[2 * n :]))

    class Gibbs(mcmc.ParticleGibbs):
        def update_theta(self, theta: Any, x: Any) -> Any:
            new = theta.copy()
            new["tau"], new["s"] = unknowns(random, given, np.array(x), theta["tau"], theta["s"])
            paths.append(np.array(x)[:, :n].sum(axis=1))
            return new

    kind = np.dtype([("tau", float, (n,)), ("s", float, (3 * n,))])

    def run(chain: int, iterations: int) -> tuple[Rows, Rows, Rows]:
        theta = np.zeros((), kind)
        theta["tau"], theta["s"] = (np.asarray(x[chain]) for x in starts.unknown)
        paths.clear()
        one = Gibbs(niter=iterations, ssm_cls=Arm, prior=SimpleNamespace(dtype=kind), data=list(given.value),
                    theta0=theta, Nx=count)  # fmt: skip
        one.run()
        return one.chain.theta["tau"], one.chain.theta["s"], np.array(paths[-iterations:])

    begun = time.perf_counter()
    run(0, LEAST)
    chains = len(starts.path)
    iterations = max(int(seconds / chains / ((time.perf_counter() - begun) / LEAST)), LEAST)
    begun = time.perf_counter()
    kept = [run(chain, iterations) for chain in range(chains)]
    took = time.perf_counter() - begun
    size = min(len(one[2]) for one in kept)  # its first iteration may draw no parameters
    theta, variances, probes = (np.stack([one[k][-size:] for one in kept]) for k in range(3))
    return Draws(theta, variances, probes, took)


def nuts(blackjax: Any, model: Model, params: Params, data: Data, starts: Any, piece: int, seconds: float) -> Draws:
    """Run `blackjax`' NUTS on the likelihood of the linear model, the chains spread over all devices as ours are.

    Torques are scaled by the warm-up's root and variances are logarithms; step and masses are adapted first.

    Args:
        blackjax: the module.
        model: the model.
        params: parameters, tuned.
        data: the series.
        starts: states of the chains.
        piece: iterations of its own warm-up, which is not timed, and of a call.
        seconds: how long.
    """
    p = model.linear

    def unknown(params: Params, at: Any) -> Unknown:
        tuning = params.tuning
        return Unknown(tuning.linear.centre + tuning.theta_root @ at[:p], jnp.exp(at[p:]))

    def log_density(params: Params, data: Data, at: Any) -> Any:
        one, linear = unknown(params, at), params.tuning.linear
        twist = backward(model, params.prior, data, linear, one.variances)
        return log_prior(params.prior, one) + jnp.sum(at[p:]) + log_evidence(twist, linear, one.theta)

    def settle(params: Params, data: Data, variances: Any, key: Any) -> Any:
        at = jnp.concatenate([jnp.zeros(p), jnp.log(variances)])
        adaptation = blackjax.window_adaptation(blackjax.nuts, partial(log_density, params, data))
        found = adaptation.run(key, at, num_steps=piece)[0]
        return found.state, found.parameters["step_size"], found.parameters["inverse_mass_matrix"]

    def sample(params: Params, data: Data, state: Any, size: Any, masses: Any, key: Any) -> Any:
        kernel = blackjax.nuts(partial(log_density, params, data), size, masses)

        def step(state: Any, key: Any) -> Any:
            state, _ = kernel.step(key, state)
            return state, unknown(params, state.position)

        return jax.lax.scan(step, state, jax.random.split(key, piece))

    line, same = several(), (params, data)

    def spread(fn: Any) -> Any:
        return partial(shards(fn, line, common=2), *same)

    key, count = jax.random.key(1), len(starts.path)
    state, *adapted = spread(settle)(starts.unknown.variances, jax.random.split(key, count))
    run, kept = spread(sample), list[Any]()
    jax.block_until_ready(run(state, *adapted, jax.random.split(key, count)))  # compiles
    begun = time.perf_counter()
    while not kept or time.perf_counter() - begun < seconds:
        keys = jax.random.split(jax.random.fold_in(key, len(kept)), count)
        state, found = jax.block_until_ready(run(state, *adapted, keys))
        kept.append(jax.tree.map(np.asarray, found))
    took = time.perf_counter() - begun
    theta, variances = (np.concatenate([one[k] for one in kept], axis=1) for k in (0, 1))
    return Draws(theta, variances, np.zeros((*theta.shape[:2], 0)), took)


__all__ = ["THREADS", "Draws", "Problem", "ahead", "nuts", "paper", "particles_gibbs", "problem", "unknowns"]
