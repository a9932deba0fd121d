"""Tune the filter of `--method orientation` on logs whose true orientation is known."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxest.cli.methods import Request, imu_steps, orientation, orientation_filters
from jaxest.cli.tunable import Source, Tunable, constrained, plain, refuse_goal
from jaxest.io import to_si
from jaxest.io.log import where
from jaxest.types import InputError

FREE = {
    "complementary": ("proportional_gain", "integral_gain"),
    "ekf": ("misalignment", "speed", "excursion", "move_time"),
    "decoupled": (),
    "madgwick": (),
}
"""What is free unless said otherwise; where nothing stands, every positive number of the filter."""
SPARSE = ("ekf",)
"""Filters that correct at few of their samples: logs and starts are run one after the other."""
MAGNETIC = {"ekf": ("field", "field_time"), "complementary": ("lambda_mag",)}
"""And with a magnetometer."""


def prepare(sources: Sequence[Source], request: Request, goal: str, free: Mapping[str, str | None]) -> Tunable:
    """Make inclinations right, with a magnetometer the whole orientations: the mean of the recordings' RMS errors.

    Arguments and result as `jaxest.cli.tunable.prepare`. The smoother is not tuned.
    """
    from jaxest import tuning

    if goal not in ("", "error"):
        raise refuse_goal("orientation", goal, "error against a truth")
    logs = [source._replace(log=to_si(source.log)) for source in sources]
    choices = [orientation.choose(source.log, request) for source in logs]
    choice = choices[0]
    for source, other in zip(logs, choices, strict=True):
        if other.kinds != choice.kinds:
            raise InputError(
                f"{where(source.log)}holds {', '.join(other.kinds)}, expected {', '.join(choice.kinds)} as in "
                f"{logs[0].log.source or 'the first log'}; to leave one out, put this into a config:\n"
                '[orientation]\nsensors = ["gyroscope", "accelerometer"]'
            )
    system = orientation_filters.system(choice.filter, choice.kinds)
    recordings = [_recording(source, one, request) for source, one in zip(logs, choices, strict=True)]
    whole = "magnetometer" in choice.kinds
    params = choice.filter.params
    prefix = "filter." if choice.filter.name == "complementary" else ""
    bare = params.filter if prefix else params
    default = (*FREE[choice.filter.name], *(MAGNETIC.get(choice.filter.name, ()) if whole else ()))
    default = default or tuple(p for p in tuning.paths(bare) if float(_leaf(bare, p)) > 0)
    space = tuning.space(bare, constrained(free, default))
    error = tuning.errors.orientation if whole else tuning.errors.inclination

    def settings(found: Any) -> dict[str, Any]:
        numbers = {path: plain(_leaf(found, path)) for one in space.free for path in one.paths}
        if prefix:
            return {**request.settings, "filter": "complementary", **numbers}
        table = dict(request.settings.get(choice.filter.name, {}))
        for path, value in numbers.items():
            *way, last = path.split(".")
            inner = table
            for key in way:
                inner[key] = dict(inner.get(key, {}))
                inner = inner[key]
            inner[last] = value
        return {**request.settings, "filter": choice.filter.name, choice.filter.name: table}

    label = f"{'orientation' if whole else 'inclination'} RMSE, mean of the logs"
    objective = tuning.supervised(system, error, apart=choice.filter.name in SPARSE)
    return Tunable(objective, space, recordings, label, "deg", 180 / np.pi,
                   tuning.lbfgs(), None, settings, np.float32)  # fmt: skip


def _leaf(params: Any, path: str) -> Any:
    for key in path.split("."):
        params = getattr(params, key)
    return params


def _recording(source: Source, choice: orientation.Choice, request: Request) -> Any:
    """Readings and the truth at their times."""
    from jaxest import tuning

    steps = imu_steps.merged(source.log, [choice.prefix], choice.kinds, request.nan)
    if source.truth is None or source.truth is source.log:
        truth, movement, _ = orientation.known_truth(source.log, choice, steps.time)
    else:
        truth, movement, _ = orientation.known_truth(source.truth, choice, steps.time)
    if truth is None:
        raise InputError(f"{where(source.log)}there is no true orientation to tune by; name one with --truth")
    measurements = orientation.measurements(choice, steps)
    found = tuning.recording(measurements, truth.astype(np.float32), movement)
    if not found.counts.any():
        raise InputError(f"{where(source.log)}no sample is both known and moving, expected at least one to tune by")
    return found
