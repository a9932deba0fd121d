"""`--method orientation`: one IMU, with or without a magnetometer, by the filter that the config names."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.cli import orientation_errors
from jaxest.cli.methods import SIZE, Outcome, Request, imu_steps, orientation_filters
from jaxest.cli.methods.imu_steps import KINDS
from jaxest.io import SensorLog, Stream, to_si
from jaxest.io.log import stream, where
from jaxest.io.report import Row
from jaxest.io.units import kind_of
from jaxest.types import OUT_OF_RANGE, InputError, unknown_name

LOST = 0.01  # share of steps at which numbers outgrew the precision above which the result must not be used


class Choice(NamedTuple):
    """Which streams are used, and by which filter."""

    prefix: str
    """`imu0/` in a log of several IMUs"""
    kinds: tuple[str, ...]
    filter: orientation_filters.Chosen

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the streams."""
        return tuple(self.prefix + kind for kind in self.kinds)


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate the orientation of one IMU.

    Args:
        log: a log with a gyroscope and an accelerometer, and perhaps a magnetometer.
        request: settings: `imu`, `sensors`, `filter` (one of `orientation_filters.FILTERS`), `smooth`, a table of the
            filter's name with its `Params`; of the filter `complementary` its gains, `update` and a table `noise`.

    Returns:
        Streams `orientation` and, of filters that have them, `orientation_covariance` and `gyroscope_bias`, a row for
        each sample of the gyroscope and each sample of another sensor that does not coincide with one; NaN before the
        first samples have settled the orientation. Errors, if the log carries its own truth.

    Raises:
        InputError: a stream is missing or holds NaN, a setting is unknown.
    """
    log = to_si(log)
    choice = choose(log, request)
    steps = imu_steps.merged(log, [choice.prefix], choice.kinds, request.nan)
    info = orientation_filters.run(choice.filter, choice.kinds, measurements(choice, steps))
    valid = np.asarray(info.valid)

    def known(a: Any) -> Any:
        return None if a is None else np.where(valid.reshape(-1, *(1,) * (a.ndim - 1)), a, np.nan)

    quaternion, covariance, bias = known(info.quaternion), known(info.covariance), known(info.bias)
    heading = "magnetometer" in choice.kinds
    extra = {"sensors": list(choice.names), "heading": "magnetic north" if heading else "free", "order": "wxyz",
             "filter": choice.filter.name, "smoothed": choice.filter.smooth}  # fmt: skip
    tangent = {"tangent": "rotation in the sensor: truth = orientation * exp(theta)"}
    streams = {"orientation": Stream(steps.time, quaternion, "1", "earth", extra=extra)}
    if covariance is not None:
        streams["orientation_covariance"] = Stream(steps.time, covariance, "rad2", "sensor", extra=tangent)
    if bias is not None:
        streams["gyroscope_bias"] = Stream(steps.time, bias, "rad/s", "sensor")
    written = SensorLog(streams, log.source)
    truth, movement, name = known_truth(log, choice, steps.time)
    rows = [Row(SIZE[0], "", float(len(steps.time)), "1"),
            Row(SIZE[1], "", float(steps.time[-1] - steps.time[0]), "s")]  # fmt: skip
    by = f"the filter {choice.filter.name}, {'smoothed' if choice.filter.smooth else 'online'}"
    notes = [f"used {', '.join(choice.names)} by {by}" + ("" if heading else "; no magnetometer: the heading is free")]
    notes += _gap(choice, steps)
    if truth is not None:
        condition = f"to {name} in the log" + (", moving" if movement is not None else "")
        rows += orientation_errors.rows(
            quaternion, truth, covariance=covariance, movement=movement, heading=heading, condition=condition,
            place=f"{where(log)}stream {name!r}",
        )  # fmt: skip

    def draw(path: Any, title: str) -> None:
        from jaxest.viz import orientation

        orientation.draw(path, steps.time, quaternion, covariance, truth=truth, movement=movement, heading=heading,
                         title=title)  # fmt: skip

    return Outcome(written, rows, notes, _refused(info, steps) + imu_steps.rateless(steps, [choice.prefix]), draw)


def schema() -> dict[str, Any]:
    """Return what may be in the config's table `[orientation]`, as `jaxest.io.config` takes it."""
    return {"imu": str, "sensors": list, **orientation_filters.schema()}


def choose(log: SensorLog, request: Request) -> Choice:
    """Settle which streams to use, from the command line, the config and the log, in this order.

    Args:
        log: the log.
        request: settings.

    Returns:
        The choice.

    Raises:
        InputError: a setting or sensor is unknown, a stream is missing (the closest name is given), or there are
            several IMUs and none is named.
    """
    settings = request.settings
    imu = settings["imu"] if "imu" in settings else _only_imu(log)
    prefix = f"{imu}/" if imu else ""
    asked = request.sensors or tuple(settings.get("sensors", ()))
    for kind in asked:
        if kind not in KINDS:
            raise unknown_name("sensor", str(kind), KINDS)
    kinds = tuple(kind for kind in KINDS if kind in asked) if asked else KINDS[:2]
    if not asked and f"{prefix}magnetometer" in log.streams:
        kinds = KINDS
    if kinds[:2] != KINDS[:2]:
        raise InputError(f"sensors: got {', '.join(asked)}; the orientation needs gyroscope and accelerometer")
    for kind in kinds:
        stream(log, prefix + kind)
    return Choice(prefix, kinds, orientation_filters.choose(settings))


def imus(log: SensorLog) -> list[str]:
    """Return the names of a log's IMUs, `imu0` for `imu0/gyroscope`; none where its gyroscope has no prefix."""
    if "gyroscope" in log.streams:
        return []
    return [name.removesuffix("/gyroscope") for name in log.streams if name.endswith("/gyroscope")]


def _only_imu(log: SensorLog) -> str:
    """The prefix of the one IMU of the log; nothing where its streams have none."""
    found = imus(log)
    if len(found) > 1:
        lines = "\n".join(f'imu = "{name}"' for name in found)
        raise InputError(f"{where(log)}there are several IMUs; put one of these into a config:\n[orientation]\n{lines}")
    return found[0] if found else ""


def measurements(choice: Choice, steps: Any) -> Any:
    """Return what `imu_steps.merged` gave as the filters' measurements, `imu.Imu` with leaves (T, ...)."""
    from jaxest.filters.imu import Imu

    gyr, acc, mag = (steps.readings.get(choice.prefix + kind) for kind in KINDS)
    return Imu(gyr, acc, mag, steps.dt)


def known_truth(
    log: SensorLog, choice: Choice, time: NDArray[np.float64]
) -> tuple[NDArray[np.float64] | None, NDArray[np.bool_] | None, str]:
    """The log's own orientation and movement at the estimate's times, if it has them, and the orientation's name."""
    from jaxest.cli.truth import at

    name, moving = choice.prefix + "orientation", choice.prefix + "movement"
    known = [other for other in log.streams if kind_of(other) == "orientation"]
    if not choice.prefix and name not in known and len(known) == 1:  # of a camera, beside the one IMU
        name = known[0]
    if name not in log.streams:
        return None, None, ""
    truth, movement = at(log, name, log.streams.get(moving, log.streams.get("movement")), time)
    return truth, movement, name


def _gap(choice: Choice, steps: Any) -> list[str]:
    """Say where the readings pause for longer than the filter's memory."""
    worst = int(np.argmax(steps.dt))
    if not steps.dt[worst] > choice.filter.memory:
        return []
    pause, end = steps.dt[worst], steps.time[worst] - steps.time[0]
    return [f"no sample for {pause:.3g} s until {end:.3f} s: behind such a gap the estimate settles anew"]


def _refused(info: Any, steps: Any) -> list[str]:
    reasons = []
    valid = np.asarray(info.valid)
    if not valid[-1]:
        reasons.append("the orientation was never settled: no usable accelerometer (or magnetometer) sample")
    if not np.isfinite(np.asarray(info.quaternion)).all():
        reasons.append("the estimate is not finite")
    elif np.mean(np.asarray(info.status) == OUT_OF_RANGE) > LOST:
        step = float(np.median(steps.dt[1:])) if len(steps.dt) > 1 else 0.0
        reasons.append(
            f"its covariance grew out of range: steps of {step:.3g} s are too long for these gains and this motion"
        )
    return reasons
