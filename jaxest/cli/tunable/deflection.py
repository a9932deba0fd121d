"""Tune the deflection filter by its likelihood: how far joints wander in a step, how far each sensor is off."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxest.cli.methods import Request, deflection, deflection_joints, deflection_streams
from jaxest.cli.methods.deflection_config import sensors
from jaxest.cli.tunable import Source, Tunable, constrained, plain, refuse_goal
from jaxest.io import to_si
from jaxest.types import InputError

NOISY = ("concentration", "lam", "variance")
FADING = 0.9  # share of the score's past that a step carries on
WINDOW = 120  # steps of a mini-batch's windows
SETTLING = 6  # of so many one in which the filter, which begins a window where a log begins, finds the arm
RATE = 0.1
RELAXED = 64  # particles at most, for the work and the memory of a relaxation go with their square


def prepare(sources: Sequence[Source], request: Request, goal: str, free: Mapping[str, str | None]) -> Tunable:
    """Make the readings likely, by mini-batches of windows and the particle filter's score, or its relaxation.

    Arguments and result as `jaxest.cli.tunable.prepare`. Free are the walk and each sensor's noise unless said.
    """
    from jaxest import kinematics, tuning
    from jaxest.filters.resampling import stratified

    if goal in ("error", "consistency"):
        raise refuse_goal("deflection", goal, "likelihood or relaxed: a particle filter's estimates have no gradient")
    if request.robot is None:
        raise InputError("the method 'deflection' needs a robot: --robot FILE (MJCF or URDF)")
    settings, robot = request.settings, kinematics.load(request.robot)
    joints, described = deflection_joints.chosen(robot, settings), sensors(settings)
    recordings = []
    for source in sources:
        log = to_si(source.log)
        found = [deflection_streams.on_robot(log, robot, joints, one) for one in described]
        _, measurements, _ = deflection_streams.measurements(log, robot, joints, found, request.nan)
        recordings.append(tuning.recording(measurements))
    given: dict[str, Any] = {"resample": tuning.fading(stratified, FADING)}
    chosen = settings
    if goal == "relaxed":
        few = min(settings.get("particles", RELAXED), RELAXED)
        given, chosen = {"filtering": tuning.relaxed}, {**settings, "particles": few}
    system, params = deflection.system(robot, joints, found, chosen, **given)
    default = [p for p in tuning.paths(params) if p == "walk" or p.rsplit(".", 1)[-1] in NOISY]
    space = tuning.space(params, constrained(free, default))
    shortest = min(len(one.counts) for one in recordings)

    def tuned(found: Any) -> dict[str, Any]:
        table = {**settings, "sensors": {name: dict(one) for name, one in settings["sensors"].items()}}
        leaves = dict(zip(space.paths, _leaves(found), strict=True))
        for path in (p for one in space.free for p in one.paths):
            way = path.split(".")
            home = table["sensors"][way[1]] if way[0] == "sensors" else table
            home[way[-1]] = plain(leaves[path])
        return table

    length = min(WINDOW, shortest)
    windows = tuning.Windows(min(4, len(recordings)), length, length // SETTLING)
    label = "minus log-likelihood of a window" + (", relaxed" if goal == "relaxed" else "")
    return Tunable(tuning.likelihood(system, random=True), space, recordings, label, "1",
                   1.0, tuning.adam(RATE), windows, tuned, np.float32)  # fmt: skip


def _leaves(params: Any) -> list[Any]:
    import jax

    return jax.tree.leaves(params)
