"""Tune the noise of the torque estimator by the likelihood of the angles, motion and torques integrated out."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from jaxest.cli.methods import Request, torque, torque_series
from jaxest.cli.tunable import Source, Tunable, constrained, plain, refuse_goal
from jaxest.io import to_si
from jaxest.types import InputError, unknown_name


def prepare(sources: Sequence[Source], request: Request, goal: str, free: Mapping[str, str | None]) -> Tunable:
    """Make the angles likely: the samplers' collapsed density, without a prior on the noise.

    Arguments and result as `jaxest.cli.tunable.prepare`. Free are all standard deviations, equal for all joints unless
    the config gives each its own.
    """
    import jax

    from jaxest import kinematics, tuning
    from jaxest.systems import torque_evidence

    if goal not in ("", "likelihood"):
        raise refuse_goal("torque", goal, "likelihood")
    if request.robot is None:
        raise InputError("the method 'torque' needs a robot: --robot FILE (MJCF or URDF)")
    settings, robot = request.settings, kinematics.load(request.robot)
    kind = settings.get("torque", torque.TORQUES[0])
    if kind not in torque.TORQUES:
        raise unknown_name("[torque] torque", kind, torque.TORQUES)
    with jax.enable_x64(True):
        recordings = []
        for source in sources:
            series = torque_series.series(to_si(source.log), settings, tuple(robot.joint_names), request.nan)
            given = torque.problem(robot, series, settings, kind)
            recordings.append(tuning.recording(torque_evidence.linearized(given.model, robot, given.prior, given.data)))
            if source is sources[0]:
                first = given
        start = torque_evidence.noise_of(first.model, first.prior.beta / (first.prior.alpha + 1))
        one = {name: "equal-positive" if len(set(np.asarray(x).tolist())) == 1 else "positive"
               for name, x in start._asdict().items() if len(x)}  # fmt: skip
        space = tuning.space(start, constrained(free, one))
        objective = tuning.density(partial(torque_evidence.log_evidence, first.model, first.prior))

    def tuned(found: Any) -> dict[str, Any]:
        moved = {path: plain(getattr(found, path)) for one in space.free for path in one.paths}
        return {**settings, **{k: v[0] if len(set(v)) == 1 else v for k, v in moved.items()}}

    return Tunable(objective, space, recordings, "minus log-likelihood of a log", "1", 1.0, tuning.lbfgs(), None,
                   tuned, np.float64)  # fmt: skip
