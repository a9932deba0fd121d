"""Kalman filters and smoothers for states on any product manifold: in time, from link to link, for unknown torques.

Start with a `Model` (manifold, dynamics, process noise, `sensor`s as functions of `(params, x, measurement)`):
`run(filter_step(model), params, init(mean, covariance), measurements)` filters, `smooth(model, params, state0,
measurements)` smooths. `Model(iterations=10)` iterates each update; `loss=huber`, `gate=11.34` of a sensor deal with
outliers; the infos' `log_likelihood` sums to what noise parameters are tuned by, and may be differentiated.

The pieces for other orders than time, such as a chain of links: `Gaussian`, `independent`, `predict` to another
manifold, `update` with `Factor`s.

Linear-Gaussian series with square roots: `Series`, `filter_series`, `smooth_series`, and the same parallel in time.
On two cores the sequential form is twice as fast, and compiles in 3 s where the other takes 20 and more.

Not here: sigma points, ensembles, and correlated measurement noise across sensors.
"""

from jaxest.filters.kalman.factors import Factor, cauchy, huber
from jaxest.filters.kalman.gain import Gain, Gained, by_size, information_gain, measurement_gain, state_gain
from jaxest.filters.kalman.gaussian import Gaussian, independent, predict
from jaxest.filters.kalman.linear import Root, Series, filter_series, smooth_series, whitened
from jaxest.filters.kalman.model import Info, Model, Sensor, State, filter_step, init, sensor
from jaxest.filters.kalman.parallel import filter_series_parallel, smooth_series_parallel
from jaxest.filters.kalman.smoother import History, SmoothSeries, smooth
from jaxest.filters.kalman.update import UpdateInfo, update

__all__ = [
    "Factor",
    "Gain",
    "Gained",
    "Gaussian",
    "History",
    "Info",
    "Model",
    "Root",
    "Sensor",
    "Series",
    "SmoothSeries",
    "State",
    "UpdateInfo",
    "by_size",
    "cauchy",
    "filter_series",
    "filter_series_parallel",
    "filter_step",
    "huber",
    "independent",
    "information_gain",
    "init",
    "measurement_gain",
    "predict",
    "sensor",
    "smooth",
    "smooth_series",
    "smooth_series_parallel",
    "state_gain",
    "update",
    "whitened",
]
