"""What `jaxest tune` says of a search: figures, a table of parameters, a picture."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import tuning
from jaxest.cli.output import warn
from jaxest.cli.tables import grid, number
from jaxest.io.report import Row
from jaxest.tuning.problem import values_at

DRAWN = 4, 4
"""Windows and keys by which a likelihood that is drawn is judged; all data would take half an hour."""


class Judged(NamedTuple):
    """A search by what the config had before and has after it, on the same data with the same keys."""

    estimates: list[Any]
    """`jaxest.tuning.Estimate`, one an entry of the free parameters."""
    objective: tuple[float, float]
    """At the start and at the point found, of the logs tuned on."""
    held_out: tuple[float, float] | None
    """Of those held out."""


def judge(given: Any, start: Any, point: Any, parts: tuple[Any, Any], key: Any) -> Judged:
    """Evaluate start and end of a search, and what the end is worth.

    Args:
        given: the tuning.
        start: (n,) where the config was.
        point: (n,) what was found.
        parts: recordings tuned on and held out, None without these.
        key: of windows, and of what is drawn.
    """
    problem = tuning.Problem(given.objective, given.space)
    (data, held_out), ends = parts, jnp.stack([start, point])
    keys, worth = None, None
    if given.objective.random:
        pick, key = jax.random.split(key)
        keys = jax.random.split(key, DRAWN[1])
        count = data.counts.shape[0]
        windows = given.windows._replace(recordings=max(DRAWN[0], count))
        data = tuning.sample_windows(data, windows, pick)
        worth = sum(len(one.counts) for one in given.recordings[:count]) / (windows.length - windows.settle)

    def both(batch: Any) -> tuple[float, float]:
        drawn = [values_at(problem, ends, batch, one) for one in ([None] if keys is None else keys)]
        before, after = np.mean(drawn, axis=0).tolist()
        return before, after

    curvature = tuning.curvature(problem, point, data, keys, worth)
    estimates = tuning.estimates(problem, point, curvature)
    return Judged(estimates, both(data), None if held_out is None else both(held_out))


def distinct(space: Any, estimates: list[Any]) -> dict[int, Any]:
    """Entries that move, one of those that are equal, by where they stand among all; named as `--free` names them."""
    kept: dict[int, Any] = {}
    at = 0
    for one in space.free:
        size = math.prod(one.shape)
        tied = one.bijection.size == 1 and len({row.value for row in estimates[at : at + size]}) == 1
        rows = {at: estimates[at]._replace(name=one.name)} if tied else dict(enumerate(estimates[at : at + size], at))
        kept |= {i: row for i, row in rows.items() if row.sd > 0 or row.value != 0}  # a concentration that stays 0
        at += size
    return kept


def rows(given: Any, found: Any, judged: Judged, held_out: int, took: float) -> list[Row]:
    """Return how far the search came: objective, starts, evaluations, seconds `took`."""
    pairs = [("tuned", judged.objective, len(given.recordings) - held_out), ("held out", judged.held_out, held_out)]
    shown = [
        Row(given.label, condition, pair[1] * given.scale, given.unit, n=count,
            reference=pair[0] * given.scale, reference_name="start")
        for condition, pair, count in pairs if pair is not None
    ]  # fmt: skip
    spread = float(np.ptp(found.values[np.isfinite(found.values)])) * given.scale
    shown.append(Row("best of each start", "largest less smallest", spread, given.unit, n=len(found.values)))
    shown.append(Row("evaluations", f"stopped: {found.stopped}", float(int(found.search.index)), "1"))
    return [*shown, Row("run time", "compilation included", took, "s")]


def doubt(row: Any) -> str:
    """What is wrong with a parameter's standard error, empty if nothing is."""
    return "" if row.identified else "error unknown" if np.isnan(row.sd) else "not identified"


def warned(estimates: list[Any], logs: int, size: int) -> list[str]:
    """Say which parameters are known badly and why, for `logs` tuned on and `size` free numbers; return their names."""
    names: dict[str, list[str]] = {}
    for row in estimates:
        names.setdefault(doubt(row), []).append(row.name)
    if "error unknown" in names:
        warn(f"standard errors need more logs to tune on than free numbers, got {logs} for {size}")
    if "not identified" in names:
        warn(f"these logs hardly tell {', '.join(names['not identified'])}: standard errors of a factor e or more")
    return [row.name for row in estimates if doubt(row)]


def parameters(given: Any, estimates: list[Any]) -> list[Row]:
    """Return parameters for machines."""
    rows = []
    for row in estimates:
        condition = ", ".join(("free", doubt(row))) if doubt(row) else "free"
        rows.append(Row(row.name, condition, row.value, "1", spread=row.sd if np.isfinite(row.sd) else None,
                        reference=row.start, reference_name="start"))  # fmt: skip
        rows.append(Row(row.name, "rise of the objective by 10 %", row.rise * given.scale, given.unit))
    return rows


def table(given: Any, estimates: list[Any]) -> Any:
    """Parameters for people: what was found, how well it is known, what it matters."""
    unit = "" if given.unit == "1" else f", {given.unit}"
    head = ("parameter", "start", "tuned", "standard error", f"10 % more adds{unit}", "")

    def written(value: float) -> str:
        return number(value, 6 if 0.9 < value < 1 else 3)  # what is forgotten stands behind the nines

    lines = [
        (row.name, written(row.start), written(row.value), number(row.sd) if np.isfinite(row.sd) else "-",
         number(row.rise * given.scale, 2), doubt(row))
        for row in estimates
    ]  # fmt: skip
    return grid(head, lines, right=(1, 2, 3, 4))


def draw(path: Path, given: Any, found: Any, judged: bool, title: str, shown: list[int]) -> None:
    """Draw the searches' paths; `shown` are the entries that get a panel."""
    from jaxest.viz import tuning as viz

    trace = found.trace
    values, held = np.array(trace.value) * given.scale, np.array(trace.held_out) * given.scale
    points = np.array(jax.vmap(jax.vmap(given.space.values))(trace.point))
    for i, taken in enumerate(trace.taken):  # what was tried and refused is not drawn
        for series in (values, held, points):
            series[i, ~taken] = series[i - 1, ~taken] if i else np.nan
    best = int(np.argmin(np.where(np.isfinite(found.values), found.values, np.inf)))
    viz.draw(path, values, points[..., shown], names=[given.space.names[i] for i in shown], best=best,
                held_out=held if judged else None,
                label="objective" if given.unit == "1" else given.unit, title=title)  # fmt: skip


__all__ = ["Judged", "distinct", "doubt", "draw", "judge", "parameters", "rows", "table", "warned"]
