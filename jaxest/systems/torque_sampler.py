"""The posterior of torques and noise of one series: tuning, starts and samplers by name.

`tune` once, `start` chains, then `jaxest.mcmc.chains.advance(sampler(NAME, model), ...)`.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.filters.run import full
from jaxest.kinematics.robot import Robot
from jaxest.mcmc import chains, kernel, particle_gibbs, particle_mh, twist
from jaxest.mcmc.chains import Chains
from jaxest.mcmc.kernel import Kernel, Params
from jaxest.mcmc.model import Data, Model, Prior
from jaxest.parallel import several
from jaxest.systems.torque_data import check_prior
from jaxest.systems.torque_model import check_robot, require_float64
from jaxest.systems.torque_step import check_series
from jaxest.types import Array, unknown_name

SAMPLERS: Mapping[str, Callable[..., Kernel]] = {
    "gibbs": particle_gibbs.guided,
    "mh": particle_mh.guided,
    "collapsed": kernel.collapsed,
    "gibbs_sequential": partial(particle_gibbs.guided, at_once=False),
    "gibbs_bootstrap": partial(particle_gibbs.baseline, look=twist.nothing),
    "gibbs_adapted": partial(particle_gibbs.baseline, look=twist.next_only),
    "gibbs_adapted_ancestors": partial(particle_gibbs.baseline, look=twist.next_only, ancestors=True),
    "mh_bootstrap": partial(particle_mh.baseline, look=twist.nothing),
}
"""`gibbs_bootstrap` and `mh_bootstrap` are the paper's."""
SPREAD = ("gibbs", "mh", "collapsed")
"""Samplers whose chains may be spread over devices. Those that resample run as one program: on two devices of one
processor they waited for each other in batched LAPACK, and have not been tried again since that is gone."""


def sampler(name: str, model: Model, count: int | None = None) -> Kernel:
    """Return a sampler, the same object for the same arguments.

    Args:
        name: one of `SAMPLERS`.
        model: the model.
        count: number of particles, the sampler's own if None (16 guided ones, 1000 of the baselines).

    Returns:
        The kernel.

    Raises:
        InputError: there is no such sampler.
    """
    if name not in SAMPLERS:
        raise unknown_name("sampler", name, SAMPLERS)
    return _sampler(name, model, count)


@cache
def _sampler(name: str, model: Model, count: int | None) -> Kernel:
    options: dict[str, Any] = {} if count is None else {"count": count}
    return SAMPLERS[name](model, **options)


def tune(
    model: Model, robot: Robot, prior: Prior, data: Data, *, key: Array, iterations: int = 200, rounds: int = 2
) -> Params:
    """Check all input, find the most probable path, and tune the proposals.

    Args:
        model: of `torque_model`.
        robot: its parameters.
        prior: the prior.
        data: the series.
        key: random key, of the warm-up.
        iterations: of each round of the warm-up, which there is only where the variances' density has no clear mode.
        rounds: of the warm-up.

    Returns:
        Parameters of every sampler.

    Raises:
        InputError: what the robot, the prior or the data are wrong about; steps too long for explicit Euler.
        ValueError: JAX computes in float32.
    """
    require_float64()
    check_robot(robot)
    check_prior(prior, data)
    path = jnp.asarray(first_path(data, prior, model))
    centre = jnp.clip(jnp.zeros(model.linear), prior.low, prior.high)
    tuning = chains.untuned(model, robot, prior, data, path, centre)
    check_series(model, robot, data, tuning.linear)
    params = Params(robot, prior, tuning)
    params, found = chains.settle(model, params, data)
    if found:
        return params
    params = chains.warm_up(model, params, data, key=key, iterations=iterations, rounds=rounds, over=several())[0]
    return chains.settle(model, params, data, 1)[0]  # from where the chains have been there may be a mode in sight


def prepare(
    name: str, model: Model, robot: Robot, prior: Prior, data: Data, *, count: int, iterations: int,
    history: Any = full, particles: int | None = None,
) -> Future[None]:  # fmt: skip
    """Begin to compile a sampler in a thread; `tune` meanwhile.

    Args:
        name: one of `SAMPLERS`.
        model: of `torque_model`.
        robot: its parameters.
        prior: the prior.
        data: the series.
        count: chains; static.
        iterations: of one piece of the run; static.
        history: as in `torque_posterior.advance`.
        particles: number of particles, the sampler's own if None.

    Returns:
        Wait for its result before the run. On one device there is nothing to wait for.
    """
    kernel, over, wide = sampler(name, model, particles), several(), jax.config.jax_enable_x64  # type: ignore[attr-defined]

    def compiled() -> None:
        if over is not None and name in SPREAD:
            with jax.enable_x64(wide):  # a thread has settings of its own
                chains.prepare(kernel, model, robot, prior, data, count=count, iterations=iterations,
                               history=history, over=over)  # fmt: skip

    pool = ThreadPoolExecutor(1)
    found = pool.submit(compiled)
    pool.shutdown(wait=False)
    return found


def first_path(data: Data, prior: Prior, model: Model) -> NDArray[np.float64]:
    """Return a path (T, n) to start from: measured angles with gaps bridged, their differences, and nothing else."""
    value, valid = np.asarray(data.value), np.asarray(data.valid)
    time = np.concatenate([[0.0], np.cumsum(np.asarray(data.inputs.dt))])
    mean = np.asarray(prior.mean)
    angles = np.empty_like(value)
    for j in range(value.shape[1]):
        there = valid[:, j]
        angles[:, j] = np.interp(time, time[there], value[there, j]) if there.any() else mean[j]
    speeds = np.gradient(angles, time, axis=0)
    rest = np.broadcast_to(mean[2 * value.shape[1] :], (len(time), model.size - 2 * value.shape[1]))
    return np.concatenate([angles, speeds, rest], axis=1)


def start(model: Model, params: Params, data: Data, *, key: Array, count: int = 4, spread: float = 1.5) -> Chains:
    """Return chains at dispersed starts; arguments as in `mcmc.chains.dispersed`."""
    states = chains.dispersed(
        model, params.prior, data, params.tuning.linear, key=key, count=count, spread=jnp.asarray(spread)
    )
    return chains.init(key, states)


__all__ = ["SAMPLERS", "SPREAD", "first_path", "prepare", "sampler", "start", "tune"]
