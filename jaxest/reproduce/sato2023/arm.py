"""The paper's arm, its motion and its sensors, and filters on them: what figs. 6 to 10 and the studies share."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import kinematics, models
from jaxest.filters import run
from jaxest.metrics import orientation_error
from jaxest.sensors import Sensor, measurement_type
from jaxest.simulate import deflection as bent
from jaxest.systems import deflection
from jaxest.types import Array, Reading

JOINTS = ("yaw", "shoulder", "elbow", "gripper")
END = "site:end_effector"
IMUS = ("imu2", "imu3")
SENSORS = (
    Sensor("joint_angle", "encoders"),
    Sensor("link_orientation", "imu2", ("site:imu2",)),
    Sensor("link_orientation", "imu3", ("site:imu3",)),
    Sensor("link_position", "end_effector", (END,)),
)
RATE, SECONDS = 10.0, 60.0
POSTURES = np.deg2rad(
    [[0, 0, 0, 0], [40, 30, 40, -20], [40, 75, 15, -20], [-30, 60, 60, -40], [-30, 40, 20, -10], [0, 0, 0, 0]]
)
REST, MOVE = 5.0, 5.0  # s in each posture and on the way to the next
DESK = (22.0, 25.0)  # s, while the lying arm rests on the desk
PUSH = (0.0, -8.0, -2.0, 0.0)  # N m of the desk about each joint


class Scene(NamedTuple):
    """A recording and what it comes from, NumPy arrays."""

    measurements: Any
    time: NDArray[np.float64]
    """(T,) s."""
    reference: NDArray[np.float64]
    """(T, 4) rad, commanded."""
    angles: NDArray[np.float64]
    """(T, 4) rad, effective."""


class Result(NamedTuple):
    """What a filter makes of a scene."""

    mean: NDArray[np.float64]
    """(T, 4) rad."""
    lower: NDArray[np.float64]
    """(T, 4) rad, lower end of the 95 % interval."""
    upper: NDArray[np.float64]
    """(T, 4) rad, upper end."""
    ess: NDArray[np.float64]
    """(T,) effective sample size."""


class Ends(NamedTuple):
    """Where the end effector is."""

    position: NDArray[np.float64]
    """(T, 3) m."""
    quaternion: NDArray[np.float64]
    """(T, 4) wxyz."""


@functools.cache
def robot() -> kinematics.Robot:
    """Return the packaged arm."""
    return kinematics.load(models.path("arm"))


@functools.cache
def system(particles: int = 2048, propose: Any = deflection.bootstrap, noise: Any = deflection.von_mises) -> Any:
    """Return the filter with all sensors, the same object for the same choices; masks leave sensors out."""
    return deflection.build(robot(), SENSORS, particles=particles, proposal=propose, noise=noise)


def motion(time: Array) -> Array:
    """Return the commanded posture (4,) rad at a time () s: rests, and smooth ways between them."""
    starts = REST + (REST + MOVE) * np.arange(len(POSTURES) - 1)
    share = jnp.clip((time - starts) / MOVE, 0, 1)
    smooth = share * share * (3 - 2 * share)
    return POSTURES[0] + jnp.sum(smooth[:, None] * np.diff(POSTURES, axis=0), axis=0)


def push(time: Array) -> Array:
    """Return the torque (4,) N m of the desk at a time () s."""
    return jnp.where((time >= DESK[0]) & (time < DESK[1]), jnp.asarray(PUSH), 0.0)


@functools.partial(jax.jit, static_argnames=("seconds", "collision"))
def _simulate(key: Array, faults: bent.Faults, seconds: float, collision: bool) -> Any:
    return bent.simulate(
        robot(), SENSORS, key=key, duration=seconds, rate_hz=RATE, motion=motion, torque=push if collision else None,
        faults=faults,
    )  # fmt: skip


def scene(seed: int, *, collision: bool = False, seconds: float = SECONDS, drift: float = 0.0017) -> Scene:
    """Move the arm through the paper's kind of postures; the marker is always in sight.

    Args:
        seed: of sensor noise.
        collision: whether a desk is in the way.
        seconds: how long.
        drift: rad/s of the IMUs' yaw, each its own way.

    Returns:
        The scene.
    """
    faults = jax.tree.map(np.float32, bent.Faults(hidden=0.0, drift=drift))
    measurements, truth = _simulate(jax.random.key(seed), faults, seconds, collision)
    measurements = jax.tree.map(np.asarray, measurements)
    time = np.arange(len(measurements.dt)) / RATE
    return Scene(measurements, time, np.asarray(truth.reference, float), np.asarray(truth.angles, float))


def using(one: Scene, names: Sequence[str], seen: NDArray[np.bool_] | None = None) -> Any:
    """Return a scene's measurements with some sensors only.

    Args:
        one: the scene.
        names: the sensors that speak.
        seen: (T,) when the end effector is seen; always if None.

    Returns:
        Measurements, the others masked.
    """
    readings = {}
    for sensor in SENSORS:
        reading = getattr(one.measurements, sensor.name)
        valid = reading.valid & (sensor.name in names)
        if sensor.name == "end_effector" and seen is not None:
            valid = valid & seen
        readings[sensor.name] = Reading(reading.value, valid)
    return measurement_type(SENSORS)(**readings, dt=one.measurements.dt)


def params(**changes: Any) -> deflection.Params:
    """Return Table I's parameters with changes.

    Args:
        changes: `walk`, `prior`; or a sensor's name with its `Params`.

    Returns:
        The parameters, in float32.
    """
    given = system().default_params
    own = {name: value for name, value in changes.items() if name in given._fields}
    rest = {name: value for name, value in changes.items() if name not in own}
    changed = given._replace(**own, sensors=given.sensors._replace(**rest))
    return jax.tree.map(lambda x: np.asarray(x, np.float32), changed)


def estimate(measurements: Any, seed: int, chosen: Any = None, given: Any = None) -> Result:
    """Run a filter.

    Args:
        measurements: from `using`.
        seed: of the particles.
        chosen: the system; the paper's bootstrap filter with 2048 particles if None.
        given: parameters; Table I's if None.

    Returns:
        Means and intervals.
    """
    chosen, given = chosen or system(), given if given is not None else params()
    key = jax.random.key(seed + 1000)
    _, found = run(chosen.step, given, chosen.init(given, key=key), measurements, key=key,
                   history=deflection.with_interval)  # fmt: skip
    mean, lower, upper, ess = (
        np.asarray(x, float) for x in (found.info.mean, found.lower, found.upper, found.info.ess)
    )
    return Result(mean, mean + lower, mean + upper, ess)


@jax.jit
def _ends(q: Array) -> Any:
    return jax.vmap(lambda q: kinematics.forward(robot(), q, [END]))(q)


def ends(q: NDArray[Any]) -> Ends:
    """Return where the end effector of a rigid arm is at q (T, 4) rad: for the reference, naive forward kinematics."""
    frames = _ends(jnp.asarray(q, jnp.float32))
    return Ends(np.asarray(frames.position[:, 0], float), np.asarray(frames.quaternion[:, 0], float))


def rms(x: NDArray[np.float64]) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(x))))


def gap(one: Ends, other: Ends) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distance (T,) m and the angle (T,) rad between two poses."""
    angle = np.asarray(orientation_error(one.quaternion, other.quaternion).total)
    return np.linalg.norm(one.position - other.position, axis=1), angle
