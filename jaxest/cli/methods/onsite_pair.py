"""`--method onsite` of two IMUs on one rigid link: the pose of one in the other."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxest.cli.methods import SIZE, Outcome, onsite_config
from jaxest.cli.methods import onsite_poses as poses
from jaxest.cli.methods.onsite_imus import AXES, axes_off, calibrations, recording, single
from jaxest.cli.methods.orientation import imus
from jaxest.io import SensorLog
from jaxest.io.log import where
from jaxest.io.report import Row
from jaxest.types import InputError

TUNED = ("gyroscope_noise", "forgetting_rotation", "forgetting_position")


def estimate(log: SensorLog, settings: Mapping[str, Any], nan: str) -> Outcome:
    """Estimate the pose of one IMU in another; arguments, result and errors as `recorded` and `onsite.estimate`."""
    names, prior, found = recorded(log, settings, nan)
    one = found.estimate
    position, turn, covariance = (np.asarray(x, np.float64) for x in one[:3])
    live = _live(found, prior, settings)
    extra = {"of": names[1], "tangent": "rotation in the second IMU, then position in the first: rad, m"}
    streams = poses.streams("", found.time[-1:], position[None], turn[None], covariance[None], names[0], extra)
    streams |= poses.streams("live/", found.time, live[0], live[1], live[2], names[0], extra)
    rows = [Row(SIZE[0], "", float(len(found.time)), "1"), Row(SIZE[1], "", float(found.time[-1] - found.time[0]), "s")]
    rows += poses.rows(f"{names[1]} in {names[0]}", position, turn, covariance)
    rows += [Row("rates' residual", "a sample", float(one.rate_residual), "rad/s"),
             Row("forces' residual", "a sample", float(one.force_residual), "m/s2")]  # fmt: skip
    if found.offset:
        rows.append(Row("clock offset", names[1], 1e3 * found.offset.seconds, "ms", 1e3 * found.offset.deviation))
    true = onsite_config.truth(settings)
    rows += _errors(position, turn, true)
    step = (found.time[-1] - found.time[0]) / max(len(found.time) - 1, 1)
    notes = [
        f"{names[1]} in {names[0]}, windows of {2 * found.half_width + 1} samples, "
        f"{2e3 * found.half_width * step:.0f} ms",
        *found.notes,
    ]

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import onsite as picture

        title_of = f"{names[1]} in {names[0]}"
        places = None if true.position is None else [true.position]
        picture.draw(path, found.time, {title_of: (live[0], live[2])}, {title_of: position}, places, title=title)

    return Outcome(SensorLog(streams, log.source), rows, notes, [], draw)


def recorded(log: SensorLog, settings: Mapping[str, Any], nan: str) -> tuple[tuple[str, str], Any, Any]:
    """Solve for the pose of one IMU in another from all of a log.

    Args:
        log: the log, in SI units.
        settings: the config's table `[onsite]`.
        nan: `error`, or `missing`.

    Returns:
        The IMUs' names, the `onsite_batch.Prior` that config and calibrations give, and an `onsite_recording.Found`.

    Raises:
        InputError: as `onsite.estimate`.
    """
    from jaxest.systems import onsite_batch, onsite_recording

    names = _names(log, settings)
    known, notes = calibrations(settings, names)
    a, p = (recording(log, name, nan, known) for name in names)
    usual = onsite_batch.Prior()
    if all(name in known for name in names):
        usual = usual._replace(accelerometer_bias=_mean(known[n].accelerometer_bias_deviation for n in names))
    prior = onsite_batch.Prior(*(_positive(settings, key, getattr(usual, key)) for key in usual._fields[:2]),
                               *axes_off(settings, names, known, _mean))  # fmt: skip
    align = settings.get("clocks", True)
    found = onsite_recording.estimate(a, p, prior=prior, names=names, align_clocks=align)
    return names, prior, found._replace(notes=(*notes, *found.notes))


def _names(log: SensorLog, settings: Mapping[str, Any]) -> tuple[str, str]:
    there = imus(log)
    first, second = settings.get("first"), settings.get("second")
    if first is None or second is None:
        if len(there) != 2:
            found = ", ".join(there) or "none with a name before its streams, as in imu0/gyroscope"
            raise InputError(
                f'{where(log)}IMUs: {found}; say which two in a config: [onsite] first = "..." second = "..."'
            )
        first = first or next(n for n in there if n != second)
        second = second or next(n for n in there if n != first)
    if first == second:
        raise InputError(f"[onsite] first, second: both are {first!r}, expected two IMUs")
    return first, second


def _positive(settings: Mapping[str, Any], key: str, usual: Any) -> Any:
    value = float(settings.get(key, usual))
    if not (value > 0 and math.isfinite(value)):
        raise InputError(f"[onsite] {key}: got {value}, expected a number above 0")
    return np.float64(value)


def _mean(deviations: Iterable[float]) -> float:
    """Return the deviation of each of several sensors that together err as much as these: by the sum of variances."""
    return float(np.sqrt(np.mean(np.square(list(deviations)))))


def _live(found: Any, prior: Any, settings: Mapping[str, Any]) -> Any:
    """Position (T, 3), quaternion (T, 4) and covariance (T, 6, 6) as known at each sample; NaN while they are not."""
    import jax

    from jaxest.filters import run
    from jaxest.systems import onsite

    step = float(np.median(np.diff(found.time)))
    system = onsite.build(half_width=max(2, round(_positive(settings, "window", 0.07) / step)))
    off = {key: getattr(prior, key) for key in (*AXES, "accelerometer_bias")}
    off |= {key: _positive(settings, key, getattr(system.default_params, key)) for key in TUNED if key in settings}
    for key in TUNED[1:]:
        if off.get(key, 1) > 1:
            raise InputError(f"[onsite] {key}: got {off[key]}, expected a number above 0, to 1")
    params = jax.tree.map(np.float32, system.default_params._replace(**off))

    def kept(state: Any, info: Any) -> Any:
        return info.position, info.quaternion, info.covariance, info.valid

    history = run(system.step, params, system.init(params), single(found.measurements), history=kept)[1]
    *values, valid = (np.asarray(x) for x in history)
    return tuple(np.where(valid.reshape(-1, *(1,) * (v.ndim - 1)), v, np.nan).astype(np.float64) for v in values)


def _errors(position: Any, turn: Any, true: onsite_config.Truth) -> list[Row]:
    """Errors to what the config knows of the pose."""
    from jaxest.systems.onsite_recording import rotation_error

    rows = []
    if true.position is not None:
        distance = float(np.linalg.norm(position - true.position))
        rows.append(Row("position error", "to the config's", 1e3 * distance, "mm"))
    if true.quaternion is not None:
        angle = rotation_error(np.asarray(turn, np.float32), true.quaternion.astype(np.float32))
        rows.append(Row("rotation error", "to the config's", math.degrees(angle), "deg"))
    return rows


__all__ = ["estimate", "recorded"]
