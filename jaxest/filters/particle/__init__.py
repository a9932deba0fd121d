"""Particle filters for states on any product manifold, by functions of `(params, x, measurement)`.

Start with a `Transition` (or `gaussian(mean, deviation)`) and a log-likelihood: `Model(manifold, bootstrap(manifold,
transition, log_likelihood))`, then `run(filter_step(model), params, init(particles), measurements, key=key)`. Where
the measurement is much narrower than the noise, most bootstrap particles are lost; `guided(manifold, transition,
log_likelihood, differentiated(manifold, residual))` sends them where the measurement is, with exact weights.

`resample` of the model: `systematic` (default), `stratified`, `multinomial`, `residual` of `jaxest.filters.resampling`,
or `adaptive(...)` of one. Infos carry mean, covariance, effective sample size and log-likelihood; `interval` gives
quantiles of a state's particles.

The gradient of the log-likelihood is an estimate of the score by Fisher's identity. It has the right mean, and a
variance that grows with the square of the steps; initial particles are constants to it.

Not here: likelihoods of sensors (`jaxest.sensors`), smoothing and parameters (`jaxest.mcmc`).
"""

from jaxest.filters.particle.filter import Info, Model, State, filter_step, init
from jaxest.filters.particle.guided import Guided, guided
from jaxest.filters.particle.proposal import LogLikelihood, Proposal, Rows, bootstrap, differentiated
from jaxest.filters.particle.summary import Interval, interval, mean_and_covariance
from jaxest.filters.particle.transition import Opening, Transition, gaussian

__all__ = [
    "Guided",
    "Info",
    "Interval",
    "LogLikelihood",
    "Model",
    "Opening",
    "Proposal",
    "Rows",
    "State",
    "Transition",
    "bootstrap",
    "differentiated",
    "filter_step",
    "gaussian",
    "guided",
    "init",
    "interval",
    "mean_and_covariance",
]
