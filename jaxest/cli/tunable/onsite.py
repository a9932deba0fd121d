"""Tune what the live estimate of two IMUs on a link forgets, its noise and its window.

Noise and forgetting by the likelihood of windows side by side. The window is a whole number, and other windows make
other data, whose likelihoods do not compare: it is taken from a grid, by the variance that a rigid link's position
would have, as the estimate of a whole recording takes its own.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxest.cli.methods import Request, onsite_pair
from jaxest.cli.tunable import Source, Tunable, constrained, plain, refuse_goal
from jaxest.io import to_si
from jaxest.types import InputError

FREE = ("gyroscope_noise", "force_noise", "forgetting_rotation", "forgetting_position")
MOST = 0.9999  # a share of 1 has no place on a logarithm; the search begins here where the config says 1


def prepare(sources: Sequence[Source], request: Request, goal: str, free: Mapping[str, str | None]) -> Tunable:
    """Make rates and forces likely, or their innovations as large as the filter says.

    Arguments and result as `jaxest.cli.tunable.prepare`. Free are noise and forgetting unless said.
    """
    import jax

    from jaxest import tuning
    from jaxest.systems import onsite_drift

    if goal not in ("", "likelihood", "consistency"):
        raise refuse_goal("onsite", goal, "likelihood or consistency")
    settings = request.settings
    if "modules" in settings:
        raise InputError("[onsite.modules]: a robot of modules is not tuned; name two of its IMUs: first, second")
    found = [onsite_pair.recorded(to_si(source.log), settings, request.nan)[2] for source in sources]
    steps = [float(np.median(np.diff(one.time))) for one in found]
    window = float(settings.get("window", np.median([s * one.half_width for s, one in zip(steps, found, strict=True)])))
    half_width = max(2, round(window / float(np.median(steps))))
    system = onsite_drift.build(half_width=half_width)
    with jax.enable_x64(True):
        recordings = [
            tuning.recording(onsite_drift.rows(one.measurements, one.estimate, half_width=half_width)) for one in found
        ]
    start = system.default_params._replace(**{k: settings[k] for k in system.default_params._fields if k in settings})
    start = start._replace(**{k: min(getattr(start, k), MOST) for k in FREE[2:]})
    space = tuning.space(start, constrained(free, FREE))

    def tuned(params: Any) -> dict[str, Any]:
        moved = {path: plain(getattr(params, path)) for one in space.free for path in one.paths}
        return {**settings, "window": plain(window), **moved}

    consistent = goal == "consistency"
    objective = tuning.consistency(system) if consistent else tuning.likelihood(system)
    label = "inconsistency of the innovations" if consistent else "minus log-likelihood of a log"
    return Tunable(objective, space, recordings, label, "1", 1.0, tuning.lbfgs(), None, tuned, np.float64)
