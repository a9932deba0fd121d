"""`--method onsite`: the pose of one IMU in another on an unknown link, or all links of a robot of joint modules."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxest.cli.methods import SIZE, Outcome, Request, onsite_config
from jaxest.cli.methods.onsite_config import schema
from jaxest.cli.methods.orientation import imus
from jaxest.io import SensorLog, Stream, to_si
from jaxest.io.log import refuse_nan, stream, where
from jaxest.io.report import Row
from jaxest.types import InputError

KINDS = ("gyroscope", "accelerometer")
AXES = ("gyroscope_axes", "accelerometer_axes")
TUNED = ("gyroscope_noise", "forgetting_rotation", "forgetting_position")
KEPT = ("position", "orientation", "pose_covariance")
ROBOTS = ("robot.xml", "robot.urdf")


def files(settings: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the files that are written beside the estimate: of a robot, its MJCF and URDF."""
    return ROBOTS if "modules" in settings else ()


def estimate(log: SensorLog, request: Request) -> Outcome:
    """Estimate where IMUs or joints are on unknown links.

    Args:
        log: a log with a gyroscope and an accelerometer for each IMU.
        request: the config's table `[onsite]`, see `onsite_config`.

    Returns:
        Of two IMUs the streams `position`, `orientation` and `pose_covariance` of the second in the first, one row from
        the whole recording, and the same with `live/` before them as they were known at each sample. Of a robot these
        streams with the next joint's name before them, of joint in joint, and the robot as MJCF and URDF.

    Raises:
        InputError: streams are missing, sensors or clocks are not fit, IMUs are not on one rigid link, or the motion
            does not determine a component; which is said.
    """
    log, settings = to_si(log), request.settings
    onsite_config.refuse_idle(settings)
    return _robot(log, settings, request.nan) if "modules" in settings else _pair(log, settings, request.nan)


def _imu(log: SensorLog, name: str, nan: str, calibrations: Mapping[str, Any]) -> Any:
    """One IMU's recording, calibrated; the accelerometer at the gyroscope's stamps, where it has others."""
    from jaxest.calibration import imu as calibrated
    from jaxest.io import interpolate
    from jaxest.systems.onsite_recording import Imu

    gyro, force = (stream(log, f"{name}/{kind}") for kind in KINDS)
    for item, kind in ((gyro, KINDS[0]), (force, KINDS[1])):
        if nan == "error":
            refuse_nan(item, f"{where(log)}stream '{name}/{kind}'", 'nan = "missing" in a config')
    time, rates = gyro.time, np.asarray(gyro.value, np.float64)
    if not np.array_equal(time, force.time):
        inside = (time >= force.time[0]) & (time <= force.time[-1])
        time, rates = time[inside], rates[inside]
        found = interpolate(log, [f"{name}/{KINDS[1]}"], time, nan="invalid").readings[f"{name}/{KINDS[1]}"]
        forces = np.where(np.asarray(found.valid)[:, None], np.asarray(found.value, np.float64), np.nan)
    else:
        forces = np.asarray(force.value, np.float64)
    kept = np.isfinite(rates).all(axis=1) & np.isfinite(forces).all(axis=1)
    time, rates, forces = time[kept], rates[kept], forces[kept]
    if len(time) < 50:
        raise InputError(f"{where(log)}{name}: {len(time)} samples, expected at least 50")
    if name in calibrations:
        rates, forces = calibrated.apply(calibrations[name], rates, forces)
    return Imu(time, rates, forces)


def _calibrations(settings: Mapping[str, Any]) -> dict[str, Any]:
    from jaxest.calibration import imu as calibrated

    return calibrated.load(settings["calibration"]) if "calibration" in settings else {}


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


def recorded(log: SensorLog, settings: Mapping[str, Any], nan: str) -> tuple[tuple[str, str], Any, Any]:
    """Solve for the pose of one IMU in another from all of a log.

    Args:
        log: the log, in SI units.
        settings: the config's table `[onsite]`.
        nan: `error`, or `missing`.

    Returns:
        The IMUs' names, the `onsite_batch.Prior` that config and calibrations give, and an `onsite_recording.Found`.

    Raises:
        InputError: as `estimate`.
    """
    from jaxest.systems import onsite_batch, onsite_recording

    names, known = _names(log, settings), _calibrations(settings)
    a, p = (_imu(log, name, nan, known) for name in names)
    usual = onsite_batch.Prior()
    if all(name in known for name in names):
        usual = usual._replace(accelerometer_bias=_mean(known[n].accelerometer_bias_deviation for n in names))
    prior = onsite_batch.Prior(*(_positive(settings, key, getattr(usual, key)) for key in usual._fields[:2]),
                               *_axes(settings, names, known, _mean))  # fmt: skip
    align = settings.get("clocks", True)
    return names, prior, onsite_recording.estimate(a, p, prior=prior, names=names, align_clocks=align)


def _pair(log: SensorLog, settings: Mapping[str, Any], nan: str) -> Outcome:
    names, prior, found = recorded(log, settings, nan)
    one = found.estimate
    position, turn, covariance = (np.asarray(x, np.float64) for x in one[:3])
    live = _live(found, prior, settings)
    extra = {"of": names[1], "tangent": "rotation in the second IMU, then position in the first: rad, m"}
    streams = _streams("", found.time[-1:], position[None], turn[None], covariance[None], names[0], extra)
    streams |= _streams("live/", found.time, live[0], live[1], live[2], names[0], extra)
    rows = [Row(SIZE[0], "", float(len(found.time)), "1"), Row(SIZE[1], "", float(found.time[-1] - found.time[0]), "s")]
    rows += _pose_rows(f"{names[1]} in {names[0]}", position, turn, covariance)
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


def _positive(settings: Mapping[str, Any], key: str, usual: Any) -> Any:
    value = float(settings.get(key, usual))
    if not (value > 0 and math.isfinite(value)):
        raise InputError(f"[onsite] {key}: got {value}, expected a number above 0")
    return np.float64(value)


def _axes(
    settings: Mapping[str, Any], names: Sequence[str], known: Mapping[str, Any], of: Callable[..., float]
) -> list[Any]:
    """What the gyros' and the accelerometers' axes may be off: the config's word, or `of` the calibrations' words."""
    from jaxest.calibration.imu import UNCALIBRATED

    found = []
    for key in AXES:
        usual = of([getattr(known[name], key) if name in known else UNCALIBRATED for name in names])
        value = float(settings.get(key, usual))
        if not (value >= 0 and math.isfinite(value)):
            raise InputError(f"[onsite] {key}: got {value}, expected a number of 0 or more, such as 0.01 for 1 %")
        found.append(np.float64(value))
    return found


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
    single = jax.tree.map(lambda x: x.astype(np.float32) if x.dtype.kind == "f" else x, found.measurements)
    off = {key: getattr(prior, key) for key in (*AXES, "accelerometer_bias")}
    off |= {key: _positive(settings, key, getattr(system.default_params, key)) for key in TUNED if key in settings}
    for key in TUNED[1:]:
        if off.get(key, 1) > 1:
            raise InputError(f"[onsite] {key}: got {off[key]}, expected a number above 0, to 1")
    params = jax.tree.map(np.float32, system.default_params._replace(**off))

    def kept(state: Any, info: Any) -> Any:
        return info.position, info.quaternion, info.covariance, info.valid

    *values, valid = (np.asarray(x) for x in run(system.step, params, system.init(params), single, history=kept)[1])
    return tuple(np.where(valid.reshape(-1, *(1,) * (v.ndim - 1)), v, np.nan).astype(np.float64) for v in values)


def _streams(
    prefix: str, time: Any, position: Any, turn: Any, covariance: Any, frame: str, extra: Any
) -> dict[str, Stream]:
    values = zip(KEPT, (position, turn, covariance), ("m", "1", ""), strict=True)
    return {prefix + name: Stream(time, value, unit, frame, extra=extra) for name, value, unit in values}


def _pose_rows(condition: str, position: Any, turn: Any, covariance: Any) -> list[Row]:
    deviation = 1e3 * np.sqrt(np.maximum(np.diag(covariance)[3:], 0))
    rows = [
        Row(f"position {axis}", condition, 1e3 * float(position[k]), "mm", float(deviation[k]))
        for k, axis in enumerate("xyz")
    ]
    rows += [Row(f"quaternion {axis}", condition, float(turn[k]), "1") for k, axis in enumerate("wxyz")]
    spread = math.degrees(math.sqrt(max(float(np.trace(covariance[:3, :3])), 0.0)))
    return [*rows, Row("rotation, standard deviation", condition, spread, "deg")]


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


def _robot(log: SensorLog, settings: Mapping[str, Any], nan: str) -> Outcome:
    import jax

    from jaxest.calibration import imu_static
    from jaxest.filters import run
    from jaxest.kinematics import to_mjcf, to_urdf
    from jaxest.systems import onsite_chain

    described, known = onsite_config.modules(settings), _calibrations(settings)
    links: Any = [tuple(_imu(log, name, nan, known) for name in ends) for ends in described.imus]
    bias, notes = np.zeros((len(links), 2, 3)), []
    for k, ends in enumerate(described.imus):
        for e, name in enumerate(ends):
            try:
                bias[k, e] = imu_static.calibrate(*links[k][e]).gyroscope_bias
            except InputError:
                notes.append(f"{name}: no rest in the recording, its gyro's bias is estimated along")
    time, samples = onsite_chain.samples(links)
    step = float(np.median(np.diff(time)))
    system = onsite_chain.build(described.assembly, half_width=max(2, round(0.08 / step)))
    limits = {"position_limit": float(settings.get("position_limit", 0.005)),
              "rotation_limit": math.radians(float(settings.get("rotation_limit_deg", 0.1)))}  # fmt: skip
    params = system.default_params._replace(bias=bias, **limits)
    axes = dict(zip(AXES, _axes(settings, [name for ends in described.imus for name in ends], known, max), strict=True))
    params = params._replace(pair=params.pair._replace(gyroscope_bias=0.3 if notes else 0.003, **axes))
    params, samples = jax.tree.map(_single, (params, samples))
    info = jax.tree.map(np.asarray, run(system.step, params, system.init(params), samples)[1])
    final = jax.tree.map(lambda x: x[-1], info)
    robot = onsite_chain.rebuild(described.assembly, final)
    names = [described.assembly.modules[k + 1].name for k in described.assembly.unknown]
    before = [described.assembly.modules[k].name for k in described.assembly.unknown]
    streams: dict[str, Stream] = {}
    rows = [Row(SIZE[0], "", float(len(time)), "1"), Row(SIZE[1], "", float(time[-1] - time[0]), "s")]
    for k, (name, parent) in enumerate(zip(names, before, strict=True)):
        extra = {"of": name, "tangent": "rotation in the next joint, then position in the joint before: rad, m"}
        streams |= _streams(f"{name}/", time, info.position[:, k].astype(float), info.quaternion[:, k].astype(float),
                            info.covariance[:, k].astype(float), parent, extra)  # fmt: skip
        rows += _pose_rows(
            f"{name} in {parent}", final.position[k], final.quaternion[k], final.covariance[k].astype(float)
        )
        rows.append(Row("95 %, position", f"{name} in {parent}", 1e3 * float(final.spread[k, 1]), "mm"))
        rows.append(Row("95 %, rotation", f"{name} in {parent}", math.degrees(float(final.spread[k, 0])), "deg"))
    if info.done.any():
        rows.append(Row("known to the limits after", "", float(time[int(np.argmax(info.done))] - time[0]), "s"))
    refused = [] if info.done.any() else [_open(names, final, limits, axes[AXES[0]])]

    def draw(path: Path, title: str) -> None:
        from jaxest.viz import onsite as picture

        curves = {
            f"{n} in {b}": (info.position[:, k], info.covariance[:, k])
            for k, (n, b) in enumerate(zip(names, before, strict=True))
        }
        picture.draw(path, time, curves, {}, None, title=title)

    texts = dict(zip(ROBOTS, (to_mjcf(robot), to_urdf(robot)), strict=True))
    return Outcome(SensorLog(streams, log.source), rows, notes, refused, draw, texts)


def _single(x: Any) -> Any:
    x = np.asarray(x)
    return x.astype(np.float32) if x.dtype.kind == "f" else x


def _open(names: list[str], final: Any, limits: Mapping[str, float], axes: float) -> str:
    worst = [
        f"{name} to {1e3 * float(s[1]):.1f} mm and {math.degrees(float(s[0])):.2f} deg"
        for name, s in zip(names, final.spread, strict=True)
    ]
    # Turned evenly about all axes, a link's rotation is off about each by the entry's deviation.
    least = 2 * math.sqrt(3) * axes
    advice = "swing more joints, longer or harder"
    if least > limits["rotation_limit"]:
        advice = (
            f"gyros whose axes are off by {100 * axes:.2g} % leave {math.degrees(least):.2f} deg however long they "
            "swing: calibrate them (jaxest.calibration.tumble), or say gyroscope_axes in the config"
        )
    return (
        f"known at 95 % {', '.join(worst)}; expected {1e3 * limits['position_limit']:g} mm and "
        f"{math.degrees(limits['rotation_limit']):g} deg: {advice}"
    )


__all__ = ["TUNED", "estimate", "files", "recorded", "schema"]
