"""A rod with two IMUs that rests, turns slowly and is shaken, and its calibration."""

import functools
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.calibration import imu
from jaxest.simulate.noise import Triad, corrupt
from jaxest.systems import onsite
from jaxest.systems.onsite_simulation import Pair
from jaxest.types import Reading

RATE = 100.0
REST, TURNING, SHAKING = 1000, 10000, 4000  # samples. Source: Sato 2024, section III-E
GYRO = Triad(density=0.01 / np.sqrt(RATE), bias=0.05)
ACCELEROMETER = Triad(density=0.05 / np.sqrt(RATE), bias=0.3, scale=0.02, misalignment=np.deg2rad(1.0))


class Recorded(NamedTuple):
    """A rod's readings, NumPy arrays."""

    readings: tuple[NDArray[np.float64], ...]
    """gyro and accelerometer of A, then of P, (T, 3) each: a rest, slow turning, shaking."""
    rate: NDArray[np.float64]
    """(T, 3) rad/s, true, in A."""
    position: NDArray[np.float64]
    """(3,) m, of P in A."""
    quaternion: NDArray[np.float64]
    """(4,) wxyz."""


@functools.cache
def params() -> onsite.Params:
    """Return the live system's parameters, float32."""
    given = jax.tree.map(np.float32, onsite.build().default_params)
    return onsite.Params(*given)


@partial(jax.jit, static_argnames=("steps", "speed", "slowest", "fastest", "shaking"))
def _ideal(key: Any, steps: int, speed: float, slowest: float, fastest: float, shaking: float) -> Any:
    return onsite.simulate(
        params(), key=key, steps=steps, speed=speed, slowest=slowest, fastest=fastest, shaking=shaking, gyroscope=0.0,
        accelerometer=0.0,
    )  # fmt: skip


@jax.jit
def _corrupted(key: Any, value: Any, dt: Any, triad: Triad) -> Any:
    return corrupt(key, triad, value, dt)[0]


def record(seed: int, *, small: bool = False) -> Recorded:
    """Let a rod rest, turn slowly, and be shaken by hand; its sensors come as they are."""
    rest, turning, shaking = (300, 2000, 600) if small else (REST, TURNING, SHAKING)
    slow = (1.0, 0.05, 0.3) if small else (0.25, 0.01, 0.06)  # a short one sees all directions if it is quicker
    keys = jax.random.split(jax.random.key(seed), 5)
    parts, truths = zip(
        _ideal(keys[0], rest, 0.0, 0.5, 1.5, 0.0), _ideal(keys[0], turning, *slow, 0.0),
        _ideal(keys[0], shaking, 1.0, 0.5, 1.5, 1.0), strict=True,
    )  # fmt: skip
    dt = jnp.full(rest + turning + shaking, 1 / RATE, jnp.float32).at[0].set(0)
    readings = []
    for key, name in zip(keys[1:], Pair._fields[:4], strict=True):
        value = jnp.concatenate([getattr(part, name).value for part in parts])
        triad = GYRO if "gyro" in name else ACCELEROMETER
        readings.append(np.asarray(_corrupted(key, value, dt, triad), np.float64))
    truth = truths[2]
    rate = np.concatenate([np.asarray(t.rate, np.float64) for t in truths])
    return Recorded(tuple(readings), rate, np.asarray(truth.position, float), np.asarray(truth.quaternion, float))


def corrected(one: Recorded, *, small: bool = False, calibrating: bool = True) -> tuple[Pair, list[imu.Calibration]]:
    """Calibrate from rest and turning, and correct the shaking.

    Args:
        one: the recording.
        small: as it was recorded.
        calibrating: whether to calibrate the accelerometers too.

    Returns:
        The shaking's measurements, float32, and the calibrations of A and P.
    """
    rest, turning = (300, 2000) if small else (REST, TURNING)
    time = np.arange(len(one.readings[0])) / RATE
    still, slow, shaken = slice(0, rest), slice(rest, rest + turning), slice(rest + turning, None)
    found: list[imu.Calibration] = []
    values: list[NDArray[np.float64]] = []
    for gyro, force in (one.readings[:2], one.readings[2:]):
        resting, turned = (imu.Readings(time[s], gyro[s], force[s]) for s in (still, slow))
        found.append(imu.calibrate(resting, turned if calibrating else None))
        values += imu.apply(found[-1], gyro[shaken], force[shaken])
    there: Any = np.ones(len(values[0]), np.bool_)
    dt = np.full(len(there), 1 / RATE, np.float32)
    dt[0] = 0
    readings: Any = [Reading(x.astype(np.float32), there) for x in values]  # type: ignore[arg-type]
    a, b, c, d = readings
    return Pair(a, b, c, d, dt), found


__all__ = ["RATE", "SHAKING", "Recorded", "corrected", "params", "record"]
