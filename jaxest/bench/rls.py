"""Recursive least squares of three unknowns: live, and a thousand at once, beside the paper's recursion in NumPy."""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, race
from jaxest.filters import last, rls, run
from jaxest.io.report import Row
from jaxest.types import Reading

UNKNOWN = np.array([-0.2, 0.05, 0.1])
NOISE, FORGETTING, LAG = 0.01, 0.999, 100


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time a step in float32. The peer has the weight of the residuals' covariance, and none of ours' own covariance.

    Args:
        peers: whether to run NumPy beside it.
        progress: hears what is being measured.
        small: few runs and steps.

    Yields:
        The time of a live step, of a step of one of many runs at once, how far from the truth either ends, and the
        time to compile.
    """
    progress("rls")
    runs, length = (3, 120) if small else (1000, 400)
    batch = _observations(runs, length)
    one = jax.tree.map(lambda x: x[0], batch)
    params = rls.Params(*(jnp.float32(x) for x in (FORGETTING, 0.0, 1e-6)))
    state, step = rls.init(params, lag=LAG), jax.jit(rls.step)
    first = jax.tree.map(lambda x: x[0], one)
    for i in range(2):  # a state as it comes from a step
        state, _ = step(params, state, jax.tree.map(lambda x, i=i: x[i], one))

    def final(observations: Any) -> Any:
        return run(rls.step, params, rls.init(params, lag=LAG), observations, history=last)[1].estimate

    every = jax.jit(jax.vmap(final))
    candidates = [
        candidate("live", step, params, state, first),
        candidate("batched", every, batch, items=runs * length),
    ]
    if peers:
        candidates.append(Candidate("NumPy", lambda: _loop(one), length))
    found = race(candidates, repeats=2 if small else 10)
    yield compare("live step", "three unknowns, each step waited for", found["live"], found.get("NumPy"))
    condition = f"{runs} runs of {length} steps at once, per step"
    yield compare("batched step", condition, found["batched"], found.get("NumPy"), unit="ns")
    off = float(np.linalg.norm(np.asarray(every(batch))[0] - UNKNOWN))
    theirs = float(np.linalg.norm(_loop(one) - UNKNOWN)) if peers else None
    yield Row(
        "error", f"the first run after {length} steps", 1e3 * off, "mm", None, 1,
        None if theirs is None else 1e3 * theirs, "NumPy" if peers else None,
    )  # fmt: skip
    for name in ("live", "batched"):
        yield compile_row(name, found[name])


def _observations(runs: int, length: int) -> rls.Observation:
    rng = np.random.default_rng(0)
    regressor: Any = rng.normal(size=(runs, length, 3, 3)).astype(np.float32)
    target: Any = (regressor @ UNKNOWN + NOISE * rng.normal(size=(runs, length, 3))).astype(np.float32)
    there: Any = np.ones((runs, length), bool)
    none = np.zeros((runs, length, 3, 3), np.float32)
    dt = np.full((runs, length), 0.01, np.float32)
    return rls.Observation(Reading(regressor, there), Reading(target, there), none, dt)


def _loop(one: rls.Observation) -> Any:
    """The estimate after the information form of Sato 2024, Algorithm 1, float64."""
    regressor, target = (np.asarray(x.value, float) for x in (one.regressor, one.target))
    information, projection, estimate = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    queue: list[Any] = []
    for o, y in zip(regressor, target, strict=True):
        queue = [*queue[1 - LAG :], y - o @ estimate]
        weight = np.linalg.inv(np.cov(np.array(queue).T)) if len(queue) == LAG else np.eye(3)
        information = FORGETTING * information + o.T @ weight @ o
        projection = FORGETTING * projection + o.T @ weight @ y
        estimate = np.linalg.solve(information, projection)
    return estimate
