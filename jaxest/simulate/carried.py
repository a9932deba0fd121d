"""What an IMU reads on a vehicle, on a walker's leg, on an arm, in a shaken hand, or on what drifts: in NumPy.

Unlike a robot's, these motions have no bound in common: a vehicle accelerates for seconds and stays fast for minutes, a
walker moves on, an arm does not leave its place. An attitude filter meets them all.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.filters.imu import Imu, imu

Array = NDArray[np.float64]
GRAVITY = 9.81
FIELD = np.array([0, 18e-6, -41e-6])  # T, east, north, up


class Sensor(NamedTuple):
    """Densities, and standard deviations of biases and scale errors along each axis; of a calibrated MEMS part."""

    gyroscope: float = 1.5e-4
    """rad/s/sqrt(Hz)"""
    accelerometer: float = 2e-3
    """m/s^2/sqrt(Hz)"""
    magnetometer: float = 0.01
    """share of the field, /sqrt(Hz)"""
    gyroscope_bias: float = 0.005
    """rad/s"""
    accelerometer_bias: float = 0.03
    """m/s^2"""
    scale: float = 0.004
    """of the gyroscope, without unit"""


class Truth(NamedTuple):
    """What the readings come from."""

    quaternion: Array
    """(T, 4) wxyz, sensor to earth"""
    acceleration: Array
    """(T, 3) m/s^2 in the earth frame"""
    bias: Array
    """(3,) rad/s"""


class Path(NamedTuple):
    """A motion, sampled."""

    quaternion: Array
    """(T, 4) wxyz, body to earth"""
    acceleration: Array
    """(T, 3) m/s^2 in the earth frame"""


def vehicle(random: np.random.Generator, time: Array) -> Path:
    """Drive: accelerate by up to 3 m/s^2 for seconds, cruise, turn by up to 4 m/s^2, brake, stand; on a rough road."""
    dt = time[1] - time[0]
    speed, turn = np.zeros_like(time), np.zeros_like(time)
    at, now = round(random.uniform(2, 6) / dt), 0.0  # stands at first
    while at < len(time):
        target = random.choice([0.0, random.uniform(3, 25)], p=[0.25, 0.75])
        pull = random.uniform(0.8, 3.0)
        change = max(round(abs(target - now) / pull / dt), 1)
        stay = round(random.uniform(3, 25) / dt)
        ramp = np.concatenate([np.linspace(now, target, change), np.full(stay, target)])[: len(time) - at]
        speed[at : at + len(ramp)] = ramp
        if target > 0 and random.random() < 0.7 and len(ramp) > change:
            rate = min(random.uniform(0.1, 0.5), 4 / target) * random.choice([-1, 1])
            begin = at + change
            turn[begin : begin + round(random.uniform(1, 8) / dt)] = rate
        at, now = at + len(ramp), target
    speed, turn = (_smooth(x, 0.5, dt) for x in (speed, turn))
    heading = random.uniform(0, 2 * np.pi) + np.cumsum(turn) * dt
    ahead, aside = np.gradient(speed, dt), speed * turn
    level = np.stack([np.cos(heading), np.sin(heading)])
    flat = ahead * level + aside * np.stack([-level[1], level[0]])
    moving = np.minimum(speed / 5, 1)
    road = 0.4 * moving[:, None] * _coloured(random, len(time), 0.03, dt)
    grade = 0.03 * moving[:, None] * _coloured(random, len(time), 5.0, dt)[:, :2]
    roll, pitch = 0.02 * aside + grade[:, 0], -0.02 * ahead + grade[:, 1]
    attitude = _product(_about(2, heading), _product(_about(1, pitch), _about(0, roll)))
    return Path(attitude, np.concatenate([flat.T, np.zeros((len(time), 1))], axis=1) + road)


def walk(random: np.random.Generator, time: Array) -> Path:
    """Walk at 1 to 1.6 m/s with the sensor on a leg, stand now and then, change direction; feet strike the ground."""
    dt = time[1] - time[0]
    pace, rate = np.zeros_like(time), np.zeros_like(time)
    at = 0
    while at < len(time):
        go = round(random.uniform(6, 25) / dt)
        pace[at : at + go] = 1
        rate[at : at + go] = random.normal(0, 0.1)
        at += go + round(random.uniform(1, 5) / dt)
    pace, rate = _smooth(pace, 0.6, dt), _smooth(rate, 0.6, dt)
    speed, cadence = random.uniform(1.0, 1.6), random.uniform(0.8, 1.05)
    heading = random.uniform(0, 2 * np.pi) + np.cumsum(rate) * dt
    phase = 2 * np.pi * cadence * time
    swing = pace * (random.uniform(0.3, 0.55) * np.sin(phase) + 0.12 * np.sin(2 * phase + random.uniform(0, 6)))
    length = random.uniform(0.3, 0.8)
    level = np.stack([np.cos(heading), np.sin(heading)])
    along = length * np.sin(swing) + 0.02 * pace * np.sin(2 * phase)
    aside = 0.02 * pace * np.sin(phase + 1)
    position = np.stack([*(np.cumsum(speed * pace * level, axis=1) * dt + along * level
                           + aside * np.stack([-level[1], level[0]])),
                         -length * np.cos(swing) + 0.02 * pace * np.cos(2 * phase)], axis=1)  # fmt: skip
    acceleration = _twice(position, dt)
    strikes = (np.floor(phase / (2 * np.pi)) != np.roll(np.floor(phase / (2 * np.pi)), 1)) & (pace > 0.5)
    decay = np.exp(-np.arange(0, 0.25, dt) / 0.03) * np.sin(2 * np.pi * 15 * np.arange(0, 0.25, dt))
    shock = np.convolve(strikes, decay)[: len(time)]
    acceleration[:, 2] += 15 * shock
    acceleration[:, :2] += 6 * shock[:, None] * level.T
    wobble = 0.05 * pace * np.sin(phase + 2)
    return Path(_product(_about(2, heading), _product(_about(1, -swing), _about(0, wobble))), acceleration)


def arm(random: np.random.Generator, time: Array) -> Path:
    """Reach from place to place within a box of 0.7 m, turning by up to 1.5 rad meanwhile, with pauses."""
    dt = time[1] - time[0]
    place, turn = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    at, here, way = 0, np.zeros(3), np.zeros(3)
    while at < len(time):
        there, to = random.uniform(-0.35, 0.35, 3), random.uniform(-1.5, 1.5, 3)
        count, stay = round(random.uniform(0.5, 1.6) / dt), round(random.uniform(0, 2.0) / dt)
        s = np.linspace(0, 1, count)
        s = np.concatenate([10 * s**3 - 15 * s**4 + 6 * s**5, np.ones(stay)])[: len(time) - at, None]
        place[at : at + len(s)], turn[at : at + len(s)] = here + s * (there - here), way + s * (to - way)
        at, here, way = at + len(s), there, to
    attitude = _product(_about(2, turn[:, 2]), _product(_about(1, turn[:, 1]), _about(0, turn[:, 0])))
    return Path(attitude, _twice(place, dt))


def shaken(random: np.random.Generator, time: Array) -> Path:
    """Shake and turn in the hand: up to 10 m/s^2 rms between 1.5 and 5 Hz, in bursts."""
    dt = time[1] - time[0]
    burst = _smooth(np.repeat(random.random(len(time) // round(3 / dt) + 1) < 0.6, round(3 / dt))[: len(time)], 0.3, dt)
    attitude, acceleration = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    for _ in range(4):
        pitch = 2 * np.pi * random.uniform(1.5, 5.0, 3)
        acceleration += random.uniform(1, 7) * np.sin(pitch * time[:, None] + random.uniform(0, 2 * np.pi, 3))
        pitch = 2 * np.pi * random.uniform(0.2, 2.0, 3)
        attitude += 0.25 * np.sin(pitch * time[:, None] + random.uniform(0, 2 * np.pi, 3))
    turned = _product(_about(2, attitude[:, 2]), _product(_about(1, attitude[:, 1]), _about(0, attitude[:, 0])))
    return Path(turned, burst[:, None] * acceleration)


def drift(random: np.random.Generator, time: Array) -> Path:
    """Accelerate at random, 1 m/s^2 with a correlation time of half a second: the velocity grows without bound."""
    dt = time[1] - time[0]
    angle = np.cumsum(_coloured(random, len(time), 0.5, dt), axis=0) * dt
    turned = _product(_about(2, angle[:, 2]), _product(_about(1, angle[:, 1]), _about(0, angle[:, 0])))
    return Path(turned, _coloured(random, len(time), 0.5, dt))


MOTIONS: Mapping[str, Callable[[np.random.Generator, Array], Path]] = {
    "vehicle": vehicle,
    "walk": walk,
    "arm": arm,
    "shaken": shaken,
    "drift": drift,
}
"""By name."""


def record(
    name: str, *, seed: int, seconds: float = 120.0, rate_hz: float = 100.0, sensor: Sensor | None = None
) -> tuple[Imu, Truth]:
    """Record an IMU that sits at any angle on what moves.

    Args:
        name: of `MOTIONS`.
        seed: of all that is random.
        seconds: duration.
        rate_hz: samples per second.
        sensor: noise and biases; None for the default.

    Returns:
        Readings with a leading axis of T, float32, all valid, and the truth.
    """
    chosen = Sensor() if sensor is None else sensor
    random = np.random.default_rng([seed, list(MOTIONS).index(name)])
    dt = 1 / rate_hz
    time = np.asarray(np.arange(round(seconds * rate_hz)) * dt, np.float64)
    path = MOTIONS[name](random, time)
    sits = random.normal(size=4)
    quaternion = _product(path.quaternion, np.broadcast_to(sits / np.linalg.norm(sits), path.quaternion.shape))
    back = quaternion * np.array([1, -1, -1, -1])
    turned = _product(np.roll(back, 1, axis=0), quaternion)
    turned[0] = [1, 0, 0, 0]
    size = np.linalg.norm(turned[:, 1:], axis=1, keepdims=True)
    angle = 2 * np.arctan2(size, np.abs(turned[:, :1])) * np.sign(turned[:, :1])
    rate = turned[:, 1:] / np.maximum(size, 1e-12) * angle / dt
    force = _rotated(back, path.acceleration + np.array([0, 0, GRAVITY]))
    field = _rotated(back, np.broadcast_to(FIELD, force.shape))
    bias = chosen.gyroscope_bias * random.normal(size=3)
    hiss = random.normal(size=(3, len(time), 3)) * np.sqrt(rate_hz)
    readings = (
        rate / (1 + chosen.scale * random.normal(size=3)) + bias + chosen.gyroscope * hiss[0],
        force + chosen.accelerometer_bias * random.normal(size=3) + chosen.accelerometer * hiss[1],
        field + chosen.magnetometer * np.linalg.norm(FIELD) * hiss[2],
    )
    found = imu(*(x.astype(np.float32) for x in readings), dt=np.full(len(time), dt, np.float32))
    return found, Truth(quaternion, path.acceleration, bias)


def _smooth(x: Array, seconds: float, dt: float) -> Array:
    """Running mean, twice."""
    width = max(round(seconds / dt), 1)
    kernel = np.ones(width) / width
    for _ in range(2):
        x = np.convolve(np.pad(np.asarray(x, float), width, mode="edge"), kernel, mode="same")[width:-width]
    return x


def _coloured(random: np.random.Generator, count: int, seconds: float, dt: float) -> Array:
    """Noise (count, 3) of unit variance with a correlation time."""
    keep = np.exp(-dt / seconds)
    fresh = np.sqrt(1 - keep * keep) * random.normal(size=(count, 3))
    found = np.empty_like(fresh)
    found[0] = random.normal(size=3)
    for k in range(1, count):
        found[k] = keep * found[k - 1] + fresh[k]
    return found


def _twice(x: Array, dt: float) -> Array:
    return np.gradient(np.gradient(x, dt, axis=0), dt, axis=0)


def _about(axis: int, angle: Array) -> Array:
    found = np.zeros((*np.shape(angle), 4))
    found[..., 0], found[..., axis + 1] = np.cos(angle / 2), np.sin(angle / 2)
    return found


def _product(p: Array, q: Array) -> Array:
    w, v = p[..., :1], p[..., 1:]
    s, u = q[..., :1], q[..., 1:]
    return np.concatenate([w * s - np.sum(v * u, axis=-1, keepdims=True), w * u + s * v + np.cross(v, u)], axis=-1)


def _rotated(q: Array, v: Array) -> Array:
    turned = 2 * np.cross(q[..., 1:], v)
    return v + q[..., :1] * turned + np.cross(q[..., 1:], turned)


__all__ = [
    "FIELD",
    "GRAVITY",
    "MOTIONS",
    "Path",
    "Sensor",
    "Truth",
    "arm",
    "drift",
    "record",
    "shaken",
    "vehicle",
    "walk",
]
