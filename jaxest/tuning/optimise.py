"""The loop: many starts at once, batches, held-out recordings, checkpoints.

The whole search is one pytree, `Search`, that `begin` makes and `advance` moves on; kept, it resumes.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from numpy.typing import NDArray

from jaxest.parallel import everywhere, gather, shards
from jaxest.tuning import descent
from jaxest.tuning.descent import Method, lbfgs
from jaxest.tuning.objectives import batched, total
from jaxest.tuning.parameters import Space
from jaxest.tuning.problem import Problem, value_and_gradient
from jaxest.tuning.recordings import Recording, sample_windows
from jaxest.types import Array, PyTree

JUDGE = np.iinfo(np.int32).max
"""No evaluation's number, folded into the key of held-out recordings: draws of each evaluation's own would keep the
luckiest."""


class Search(NamedTuple):
    """The state of a search: its checkpoint. Leaves (starts, ...) but for the last two."""

    descent: descent.State
    best: Array
    """(starts, n) the point that is kept: the lowest on the held-out recordings, or on all without them; without them,
    of mini-batches or what is drawn, the descent's `average`."""
    best_value: Array
    """(starts,) as `Result.values`."""
    since: Array
    """(starts,) int32, evaluations since it was found."""
    index: Array  # type: ignore[assignment]  # the contract's name hides a method of tuple
    """() int32, evaluations."""


class Trace(NamedTuple):
    """What each evaluation found."""

    value: NDArray[Any]
    """(evaluations, starts)"""
    held_out: NDArray[Any]
    """(evaluations, starts), NaN without held-out recordings."""
    point: NDArray[Any]
    """(evaluations, starts, n)"""
    taken: NDArray[Any]
    """(evaluations, starts) bool"""


class Result(NamedTuple):
    """What a search ended with."""

    params: PyTree
    """At the best start's best point."""
    point: Array
    """(n,) that point."""
    value: float
    """Its entry of `values`."""
    points: Array
    """(starts, n) each start's best point."""
    values: NDArray[Any]
    """(starts,) the objective there: on all recordings, or on the held-out ones where there are any. Without these,
    what is drawn or of mini-batches is not evaluated at the mean that is kept: the value of the last point taken."""
    trace: Trace
    search: Search
    stopped: str
    """Why it ended: `converged`, `held out` (no improvement there) or `evaluations`."""


def begin(problem: Problem, method: Method, points: Array) -> Search:
    """Return the search before its first evaluation.

    Args:
        problem: what is tuned.
        method: the optimiser.
        points: (starts, n), as `Space.pack` and `disperse` make them.
    """
    points = jnp.asarray(points)
    starts = points.shape[0]
    states = jax.vmap(partial(descent.init, method))(points)
    worst = jnp.full((starts,), jnp.inf, points.dtype)
    return Search(states, points, worst, jnp.zeros((starts,), jnp.int32), jnp.zeros((), jnp.int32))


def disperse(space: Space, points: int, *, key: Array, spread: Any = 1.0, dtype: Any = None) -> Array:
    """Draw starts about the space's own: the first is that, the others normal about it.

    Args:
        space: the free parameters.
        points: how many.
        key: random key.
        spread: () or (n,) standard deviation, of logarithms where a parameter is positive.
        dtype: of the points; JAX's default if None.

    Returns:
        (points, n).
    """
    centre = space.pack(space.base, dtype)
    noise = jax.random.normal(key, (points, space.size), centre.dtype).at[0].set(0)
    return centre[None] + jnp.broadcast_to(jnp.asarray(spread, centre.dtype), (points, space.size)) * noise


def advance(
    problem: Problem,
    method: Method,
    search: Search,
    batch: Recording,
    held_out: Recording | None = None,
    key: Array | None = None,
    over: Mesh | None = None,
) -> tuple[Search, tuple[descent.Info, Array]]:
    """Evaluate every start once and move it on.

    Args:
        problem: what is tuned, static.
        method: the optimiser, static.
        search: as `begin` or the previous call returned it.
        batch: the recordings (B, T, ...).
        held_out: recordings that only judge.
        key: key of the whole search, for mini-batches and for what is drawn; folded with the evaluation's number, and
            the same for all starts. What is held out is drawn in the same way at every evaluation.
        over: devices that take a share of the starts each, as `parallel.mesh` lines them up; one program if None.

    Returns:
        The search, and of each start what was found and the held-out loss (NaN without).
    """
    if problem.windows is not None:
        _given(key)
    data = (batch, held_out, key, search.index)
    if over is None:
        states, info, loss = _evaluated(problem, method, data, search.descent)
    else:
        states, info, loss = gather(_spread(problem, method, over)(data, search.descent))
    return _moved(problem, search, states, info, loss, held_out is None), (info, loss)


@partial(jax.jit, static_argnums=(0, 1))
def _evaluated(problem: Problem, method: Method, data: Any, states: descent.State) -> Any:
    return batched(problem.objective)(partial(_start, problem, method, data))(states)


@cache
def _spread(problem: Problem, method: Method, over: Mesh) -> Any:
    """Compile the evaluation of a device's starts once for the whole search."""
    return shards(partial(_start, problem, method), over, common=1, apart=problem.objective.apart)


def _start(problem: Problem, method: Method, data: Any, state: descent.State) -> Any:
    """Evaluate one start: its next state, what was found, and the held-out loss."""
    batch, held_out, key, index = data
    pick = draw = None
    if key is not None:
        pick, draw = jax.random.split(jax.random.fold_in(key, index))
    part = batch if problem.windows is None else sample_windows(batch, problem.windows, _given(pick))
    after, info = descent.step(method, lambda z: value_and_gradient(problem, z, part, draw), state)
    if held_out is None:
        return after, info, jnp.full_like(info.value, jnp.nan)
    judge = None if key is None else jax.random.fold_in(key, JUDGE)
    return after, info, total(problem.objective, problem.space.unpack(info.point), held_out, judge)


@partial(jax.jit, static_argnums=(0, 5))
def _moved(
    problem: Problem, search: Search, states: descent.State, info: descent.Info, loss: Array, alone: bool
) -> Search:  # fmt: skip
    """The search once all starts are evaluated; `alone` where no recordings are held out."""
    judged = info.value if alone else loss
    better = info.taken & (judged < search.best_value)
    noisy = problem.windows is not None or problem.objective.random
    if noisy and alone:  # no evaluation is comparable with another: the last points' mean is kept
        return Search(states, states.average, states.value, jnp.zeros_like(search.since), search.index + 1)
    return Search(
        states,
        jnp.where(better[:, None], info.point, search.best),
        jnp.where(better, judged, search.best_value),
        jnp.where(better, 0, search.since + 1),
        search.index + 1,
    )


def _given(key: Array | None) -> Array:
    if key is None:
        raise ValueError("key: got None, expected a key to draw mini-batches with")
    return key


def minimise(
    problem: Problem,
    batch: Recording,
    *,
    method: Method | None = None,
    starts: Array | None = None,
    search: Search | None = None,
    held_out: Recording | None = None,
    evaluations: int = 60,
    patience: int = 15,
    key: Array | None = None,
    over: Mesh | None = None,
    progress: Callable[[str], None] = lambda message: None,
    keep: Callable[[Search], None] = lambda search: None,
) -> Result:
    """Search for the parameters that make an objective small.

    Args:
        problem: what is tuned.
        batch: recordings (B, T, ...), as `padded` makes them.
        method: the optimiser; L-BFGS if None.
        starts: (starts, n); the space's own if None.
        search: where to resume, in place of `starts`.
        held_out: recordings that only judge: the best point there is kept, and the search ends after `patience`
            evaluations without a better one.
        evaluations: at most; of each start, in all.
        patience: as said.
        key: random key, for mini-batches and for what is drawn.
        over: as in `advance`; the same numbers come out.
        progress: hears a line an evaluation.
        keep: gets the search after every evaluation, to write it down.

    Returns:
        The result. A start whose best value is not finite never found one.

    Raises:
        ValueError: no step of the recordings, or of those held out, counts.
    """
    method = lbfgs() if method is None else method
    if search is None:
        own = problem.space.pack(problem.space.base)[None] if starts is None else starts
        search = begin(problem, method, own)
    rows = []
    data = (batch, held_out)
    for name, one in zip(("batch", "held_out"), data, strict=True):
        if one is not None and not np.any(one.counts):
            raise ValueError(f"{name}: no step counts, expected at least one")
    batch, held_out = jax.tree.map(jnp.asarray, data) if over is None else everywhere(data, over)
    while not (stopped := _ended(search, held_out is not None, evaluations, patience)):
        search, (info, loss) = advance(problem, method, search, batch, held_out, key, over)
        rows.append(Trace(*(np.asarray(x) for x in (info.value, loss, info.point, info.taken))))
        keep(search)
        progress(f"evaluation {int(search.index)}: {_best(rows[-1].value):.6g}")
    trace = Trace(*(np.stack(x) for x in zip(*rows, strict=True))) if rows else Trace(*[np.zeros((0, 0))] * 4)
    values = np.asarray(search.best_value)
    first = int(np.argmin(np.where(np.isfinite(values), values, np.inf)))
    point = search.best[first]
    return Result(problem.space.unpack(point), point, float(values[first]), search.best, values, trace, search, stopped)


def _ended(search: Search, judged: bool, evaluations: int, patience: int) -> str:
    """Why a search ends where it is, empty if it goes on."""
    if bool(jnp.all(search.descent.converged)):
        return "converged"
    if judged and bool(jnp.all(search.since >= patience)):
        return "held out"
    return "evaluations" if int(search.index) >= evaluations else ""


def _best(values: NDArray[Any]) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.min()) if finite.size else float("nan")


__all__ = ["Result", "Search", "Trace", "advance", "begin", "disperse", "minimise"]
