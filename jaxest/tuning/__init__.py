"""Tuning by gradient: noise, gains, concentrations and mountings that make an objective small on recordings.

An `Objective` says what is small (`supervised`, `likelihood`, `smoothed`, `density`, `consistency`), a `Space` which
leaves of the parameters are free and under which constraint (`space(params, {"walk": positive})`), a `Recording` what
they are tuned on (`recording`, `padded`). `minimise(Problem(objective, space), padded(recordings))` does it, from
several starts at once (`disperse`; `warm_start` where recordings are long), by L-BFGS or an optax optimiser, and
`estimates(problem, z, curvature(problem, z, batch))` says how well each parameter is known. On the command line:
`jaxest tune`.

Particle filters: `likelihood(system, random=True)`; its gradient is the score, never differentiated through
resampling. `fading(resampler, share)` trades a little bias for a variance that does not grow with time;
`relaxed` is the differentiable relaxation.

Not here: samplers of parameters (`jaxest.mcmc`).
"""

from jaxest.tuning import descent, errors, transforms
from jaxest.tuning.descent import Method, adam, lbfgs
from jaxest.tuning.objectives import (
    Objective,
    consistency,
    density,
    each,
    kalman_system,
    likelihood,
    smoothed,
    supervised,
    total,
)
from jaxest.tuning.optimise import Result, Search, begin, disperse, minimise
from jaxest.tuning.parameters import Space, paths, space
from jaxest.tuning.particles import fading, relaxed
from jaxest.tuning.problem import Problem, value_and_gradient
from jaxest.tuning.recordings import Recording, Windows, padded, recording, sample_windows, take
from jaxest.tuning.report import Curvature, Estimate, curvature, estimates
from jaxest.tuning.warm import warm_start

__all__ = [
    "Curvature",
    "Estimate",
    "Method",
    "Objective",
    "Problem",
    "Recording",
    "Result",
    "Search",
    "Space",
    "Windows",
    "adam",
    "begin",
    "consistency",
    "curvature",
    "density",
    "descent",
    "disperse",
    "each",
    "errors",
    "estimates",
    "fading",
    "kalman_system",
    "lbfgs",
    "likelihood",
    "minimise",
    "padded",
    "paths",
    "recording",
    "relaxed",
    "sample_windows",
    "smoothed",
    "space",
    "supervised",
    "take",
    "total",
    "transforms",
    "value_and_gradient",
    "warm_start",
]
