"""Which filter `--method orientation` runs, and with what parameters: the config's `filter` and the filter's table."""

import importlib
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxest.types import InputError, unknown_name

FILTERS = {
    "ekf": "jaxest.filters.attitude.ekf",
    "decoupled": "jaxest.filters.attitude.decoupled",
    "madgwick": "jaxest.filters.attitude.madgwick",
    "complementary": "jaxest.filters.complementary",
}
"""Name of a filter, and the module that holds it; the first is the default."""
UPDATES = ("exponential", "projection")
PLAIN = ("proportional_gain", "integral_gain", "lambda_acc", "lambda_mag", "update", "noise")
"""Settings of the complementary filter; where one of them stands and no `filter`, that is the filter."""
HOLD = 0.25  # s, a gap that is worth a word where no gain says how long the filter's memory is


class Chosen(NamedTuple):
    """A filter and its parameters."""

    name: str
    params: Any
    update: str
    smooth: bool

    @property
    def memory(self) -> float:
        """Seconds without a sample behind which a word is due."""
        if self.name != "complementary":
            return HOLD
        gain = self.params.filter.proportional_gain * self.params.filter.lambda_acc
        return 1 / gain if gain else np.inf


class Estimate(NamedTuple):
    """What a filter gives, (T, ...), as NumPy arrays."""

    quaternion: Any
    valid: Any
    status: Any
    bias: Any
    """None where the filter has none"""
    covariance: Any
    """None where the filter has none"""


def schema() -> dict[str, Any]:
    """Return the settings of all filters, as `jaxest.io.config` takes them."""
    from jaxest.filters.complementary import Params
    from jaxest.filters.complementary_covariance import Noise

    gains, noise = dict.fromkeys(Params._fields, float), dict.fromkeys(Noise._fields, float)
    tables = {name: _schema(_params(name)) for name in FILTERS if name != "complementary"}
    return {"filter": str, "smooth": bool, "update": str, **gains, "noise": noise, **tables}


def choose(settings: Mapping[str, Any]) -> Chosen:
    """Settle the filter and its parameters.

    Args:
        settings: the config's table `[orientation]`.

    Returns:
        The choice.

    Raises:
        InputError: a name is unknown, a number is negative, or a setting belongs to another filter.
    """
    plain = [key for key in PLAIN if key in settings]
    smooth = bool(settings.get("smooth", False))
    name = settings.get("filter", "complementary" if plain else next(iter(FILTERS)))
    if name not in FILTERS:
        raise unknown_name("[orientation] filter", str(name), FILTERS)
    tables = [key for key in FILTERS if key in settings and key != name]
    foreign = tables + (plain if name != "complementary" else [])
    if foreign:
        raise InputError(f"[orientation] {foreign[0]}: does not belong to the filter {name!r}; leave one of them out")
    if smooth and name != "ekf":
        raise InputError(f"[orientation] smooth: the filter {name!r} has no smoother, expected 'ekf'")
    if name != "complementary":
        params = _numbers(settings.get(name, {}), _params(name), f"[orientation.{name}]")
        return Chosen(name, params, UPDATES[0], smooth)
    from jaxest.filters.complementary_covariance import Params

    update = settings.get("update", UPDATES[0])
    if update not in UPDATES:
        raise unknown_name("[orientation] update", update, UPDATES)
    default = Params()
    gains = _numbers(settings, default.filter, "[orientation]")
    noise = _numbers(settings.get("noise", {}), default.noise, "[orientation.noise]")
    return Chosen(name, Params(gains, noise), update, False)


def run(chosen: Chosen, sensors: tuple[str, ...], measurements: Any) -> Estimate:
    """Run a filter over a log.

    Args:
        chosen: the filter.
        sensors: kinds that are used.
        measurements: `imu.Imu`, leaves (T, ...).

    Returns:
        The estimates.
    """
    import jax

    from jaxest.filters import attitude
    from jaxest.filters import run as scan

    built = system(chosen, sensors, covariance=chosen.name == "complementary")
    params = jax.tree.map(np.float32, chosen.params)
    if chosen.smooth:
        typical = float(np.median(measurements.dt[1:])) if len(measurements.dt) > 1 else 0.0
        block = max(1, round(float(chosen.params.interval) / typical)) if typical > 0 else 1
        info: Any = attitude.smooth(params, built.init(params), measurements, block=block)
    else:
        _, info = scan(built.step, params, built.init(params), measurements)
    found = (getattr(info, name, None) for name in Estimate._fields)
    return Estimate(*(None if value is None else np.asarray(value) for value in found))


def system(chosen: Chosen, sensors: tuple[str, ...], *, covariance: bool = False) -> Any:
    """Return a filter's `System`; `covariance` is for the complementary filter, whose `Params` it changes."""
    from jaxest.filters import complementary
    from jaxest.systems import orientation

    module = importlib.import_module(FILTERS[chosen.name])
    update = {"exponential": complementary.exponential, "projection": complementary.projection}[chosen.update]
    return orientation.build(sensors=sensors, filter=module, update=update, covariance=covariance)


def _params(name: str) -> Any:
    return importlib.import_module(FILTERS[name]).Params()


def _schema(params: Any) -> dict[str, Any]:
    return {key: _schema(value) if hasattr(value, "_fields") else float for key, value in params._asdict().items()}


def _numbers(settings: Mapping[str, Any], default: Any, place: str) -> Any:
    """Replace the defaults by the settings."""
    found = {}
    for key, value in default._asdict().items():
        if key not in settings:
            continue
        if hasattr(value, "_fields"):
            found[key] = _numbers(settings[key], value, f"{place[:-1]}.{key}]")
        elif not 0 <= settings[key] < np.inf:
            raise InputError(f"{place} {key}: got {settings[key]}, expected a number, 0 or more")
        else:
            found[key] = float(settings[key])
    return default._replace(**found)
