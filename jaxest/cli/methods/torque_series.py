"""A log's joint angles as the series of the torque estimator: chosen columns, even steps, priors from the data."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io import SensorLog, Stream
from jaxest.io.log import refuse_nan, stream, where
from jaxest.stamps import apart, longest
from jaxest.types import InputError, unknown_name

ANGLES = ("joint_position", "joints", "positions", "q")
MOST = 20000
BRIDGED = 10  # steps in gaps for each sample, at most
SLACK = 2.0  # of its own steps that a known torque may begin late or end early


class Series(NamedTuple):
    """What is estimated from, T rows."""

    time: NDArray[np.float64]
    """(T,) s; rows that bridge gaps among them."""
    angles: NDArray[np.float64]
    """(T, n) rad, 0 where missing."""
    valid: NDArray[np.bool_]
    """(T, n)"""
    feedforward: NDArray[np.float64]
    """(T, n) N m, of the step that ends at each row."""
    logged: NDArray[np.float64] | None
    """(T, n) N m, the log's own torque."""
    notes: list[str]


def series(log: SensorLog, settings: Mapping[str, Any], joints: tuple[str, ...], nan: str) -> Series:
    """Take a log's angles, and the torques that it knows.

    Args:
        log: the log, in SI units.
        settings: the config's table `[torque]`.
        joints: names of the robot's joints, for streams that name their columns.
        nan: `error`, or `missing`.

    Returns:
        The series.

    Raises:
        InputError: no such stream, columns that are not the robot's joints, NaN where it is an error, gaps that are too
            long to be bridged, torques that are not known at all times.
    """
    name = settings.get("angles") or next((one for one in ANGLES if one in log.streams), None)
    if name is None:
        raise InputError(
            f'{where(log)}no stream of joint angles among {", ".join(log.streams)}; name it: [torque] angles = "..."'
        )
    item = stream(log, name)
    every = settings.get("every", 1)
    if every < 1:
        raise InputError(f"[torque] every: got {every}, expected at least 1")
    time = np.asarray(item.time, float)[::every]
    value = _columns(log, name, item, joints)[::every]
    missing = ~np.isfinite(value)
    if missing.any() and nan == "error":
        row, column = np.argwhere(missing)[0]
        raise InputError(f'{where(log)}stream {name!r}: row {row * every}, column {column} is NaN; nan = "missing" in '
                         "the config integrates over it")  # fmt: skip
    if len(time) < 8:
        raise InputError(f"{where(log)}stream {name!r}: {len(time)} samples, expected at least 8")
    time, value, bridged = _even(time, value, f"{where(log)}stream {name!r}")
    if len(time) > MOST:
        raise InputError(f"{where(log)}stream {name!r}: {len(time)} steps, expected at most {MOST}; take --start and "
                         "--end, or [torque] every")  # fmt: skip
    known = _torque(log, settings, "feedforward", time, joints, nan)
    valid = np.isfinite(value)
    notes = [f"{len(time)} steps of {name}"] + ([f"{bridged} steps bridge gaps"] if bridged else [])
    return Series(time, np.where(valid, value, 0), valid, np.zeros_like(value) if known is None else known,
                  _torque(log, settings, "compare", time, joints, nan), notes)  # fmt: skip


def _columns(log: SensorLog, name: str, item: Stream, joints: tuple[str, ...]) -> NDArray[np.float64]:
    """A stream's columns in the robot's order, (T, n): by their names, by position only where they have none."""
    value = np.asarray(item.value, float)
    value = value.reshape(len(value), -1)
    if item.names:
        absent = [joint for joint in joints if joint not in item.names]
        if absent:
            raise InputError(
                f"{where(log)}stream {name!r}: its columns are {', '.join(item.names)}, none of them {absent[0]!r}; "
                f"expected the robot's joints {', '.join(joints)}, or whose they are in the config: "
                f'[columns."{name}"] names = [...]'
            )
        return value[:, [item.names.index(joint) for joint in joints]]
    if value.shape[1] != len(joints):
        raise InputError(f"{where(log)}stream {name!r}: {value.shape[1]} columns, expected {len(joints)}, the robot's "
                         f"joints {', '.join(joints)}")  # fmt: skip
    return value


def _even(time: NDArray[np.float64], value: NDArray[np.float64], place: str) -> tuple[NDArray[Any], NDArray[Any], int]:
    """Put rows without measurement into gaps, so that no Euler step is much longer than the others."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    more = np.maximum(np.round(steps / usual).astype(int) - 1, 0)
    if more.sum() > BRIDGED * len(time):
        row = int(np.argmax(steps))
        raise InputError(
            f"{place}: {steps[row]:.6g} s pass after row {row} at {time[row]:.3f} s, {usual:.6g} s after most; "
            f"expected gaps of at most {BRIDGED} times as many steps as there are samples; take --start and --end"
        )
    times, values = [time[:1]], [value[:1]]
    for k, extra in enumerate(more):
        times.append(np.linspace(time[k], time[k + 1], extra + 2)[1:])
        values.append(np.concatenate([np.full((extra, value.shape[1]), np.nan), value[k + 1 : k + 2]]))
    return np.concatenate(times), np.concatenate(values), int(more.sum())


def _torque(
    log: SensorLog, settings: Mapping[str, Any], key: str, time: NDArray[np.float64], joints: tuple[str, ...], nan: str
) -> NDArray[np.float64] | None:
    """A torque of the log at the angles' times, (T, n) N m; nothing is made up before its first and after its last."""
    if key not in settings:
        return None
    name = settings[key]
    if name not in log.streams:
        raise unknown_name(f"[torque] {key}: stream", name, log.streams)
    item, place = stream(log, name), f"{where(log)}stream {name!r}"
    if nan == "error":
        refuse_nan(item, place, 'nan = "missing" in a config')
    value = _columns(log, name, item, joints)
    good = np.isfinite(value).all(axis=1)
    known = item.time[good]
    slack = SLACK * float(np.median(np.diff(item.time))) if len(item.time) > 1 else 0.0
    if not len(known) or known[0] > time[0] + slack or known[-1] < time[-1] - slack:
        covered = f"covers {known[0]:.3f} to {known[-1]:.3f} s" if len(known) else "holds no number"
        raise InputError(
            f"{place}: {covered}, the angles {time[0]:.3f} to {time[-1]:.3f} s; expected a torque for all of them, or "
            "take --start and --end"
        )
    hole = apart(known, np.clip(time, known[0], known[-1])) > longest(item.time)
    if hole.any():
        row = int(np.argmax(hole))
        after = int(np.searchsorted(known, time[row]))
        raise InputError(
            f"{place}: nothing is known between {known[after - 1]:.3f} and {known[after]:.3f} s, where angles are; "
            f"expected steps of at most {longest(item.time):.6g} s, or take --start and --end"
        )
    return np.stack([np.interp(time, known, value[good, j]) for j in range(len(joints))], axis=1)
