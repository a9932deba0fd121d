"""The gripper as all parts use it: IMUs mounted some degrees off, the zero posture, pairs, and joints from them."""

from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import kinematics, models
from jaxest.calibration import mounting
from jaxest.filters import Every, Last, pair, run
from jaxest.filters.complementary import Params
from jaxest.filters.imu import Imu
from jaxest.kinematics.orientations import Observed, fit_orientations
from jaxest.manifolds import quaternion as quat
from jaxest.simulate import grasp

EDGES = ((6, 2), (2, 1), (1, 0), (2, 0), (6, 5), (5, 4), (4, 3), (5, 3))
"""Palm to base, along each finger, and the redundant pair of its first and last phalanx (IMU 1 and 3)."""
REDUNDANT = (3, 7)
GAINS = Params(1.0, 0.01)
MOUNTED = np.deg2rad(3.0)
"""rad, standard deviation of the IMUs' mounting about each axis"""
REST = 900
"""samples of the zero posture that are used"""


class Trial(NamedTuple):
    """One performance and what the IMUs said."""

    found: grasp.Performance
    measurements: Imu
    """without the gyro biases that the zero posture showed"""
    mounting: NDArray[np.float64]
    """(7, 4) as the zero posture shows them"""


@cache
def robot() -> kinematics.Robot:
    """Return the packaged gripper."""
    return kinematics.load(models.path("gripper"))


def trial(scene: grasp.Scene, seed: int, sensor: Any = None) -> Trial:
    """Perform a scene with IMUs of their own faults and mountings, and calibrate them in its zero posture."""
    found = grasp.perform(scene)
    turned = np.random.default_rng(seed).normal(0, MOUNTED, (7, 3))
    chosen = grasp.calibrated_mpu6050() if sensor is None else sensor
    measured = grasp.imus(found, chosen, jax.random.key(seed), mounting=turned)
    rate = np.asarray(measured.gyroscope.value)
    force = np.asarray(measured.accelerometer.value)
    carried = np.asarray(_zero())
    fixed = np.stack([mounting.zero_posture(force[:REST, k].mean(axis=0), carried[k]) for k in range(7)])
    still = jnp.asarray(rate - rate[:REST].mean(axis=0), jnp.float32)
    return Trial(found, measured._replace(gyroscope=measured.gyroscope._replace(value=still)), fixed)


@cache
def _zero() -> Any:
    return kinematics.forward(robot(), robot().home, grasp.SITES).quaternion


def pairs(trials: list[Trial], history: Last | Every, *, magnetic: bool = False) -> Any:
    """Run the pair filter on all edges of all trials at once; infos (trials, ...)."""
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *(t.measurements for t in trials))
    used = stacked if magnetic else stacked._replace(magnetometer=None)
    mountings = jnp.asarray(np.stack([t.mounting for t in trials]), jnp.float32)
    return _compiled(history)(mountings, used)


@cache
def _compiled(history: Last | Every) -> Any:
    init, step = pair.over(EDGES, 7)
    gains = jax.tree.map(np.float32, GAINS)
    carried = jnp.asarray(_zero(), jnp.float32)
    first, second = (np.array([edge[i] for edge in EDGES]) for i in (0, 1))

    def one(mounting: Any, measurements: Imu) -> Any:
        """Begin in the zero posture, as the paper's initialisation does."""
        earth = jax.vmap(quat.compose)(carried, mounting)
        relative = jax.vmap(lambda a, b: quat.compose(quat.inverse(a), b))(earth[first], earth[second])
        yes = jnp.ones(len(EDGES), bool)
        start = init(gains)._replace(quaternion=relative, initialized=yes, heading_initialized=yes)
        return run(step, gains, start, measurements, history=history)[1]

    return jax.jit(jax.vmap(one))


@jax.jit
def joints(rotations: Any, mountings: Any) -> Any:
    """Fit the joints to the edges' rotations: (..., e, 4) and (..., 7, 4); returns `Fit`s.

    The angle between IMU 1 and 3 takes part as a measurement of q1 + q2.
    """
    first, second = (np.array([edge[i] for edge in EDGES]) for i in (0, 1))
    names = tuple(grasp.SITES)
    ends = tuple(names[j] for _, j in EDGES), tuple(names[i] for i, _ in EDGES)
    start = jnp.asarray(robot().home, jnp.float32)
    weight = jnp.tile(jnp.eye(3, dtype=jnp.float32)[None] * 4e4, (len(EDGES), 1, 1))

    def one(rotation: Any, mounted: Any) -> Any:
        turn = jax.vmap(lambda a, r, b: quat.compose(quat.compose(a, r), quat.inverse(b)))
        seen = turn(mounted[first], rotation, mounted[second])
        return fit_orientations(robot(), ends[0], Observed(seen, weight), start, references=ends[1], iterations=8)

    return jax.vmap(one)(rotations, jnp.asarray(mountings, jnp.float32))


def finger_deviations(covariance: NDArray[Any]) -> NDArray[np.float64]:
    """Return the standard deviations (..., 6), rad, of `finger_angles`, from covariances (..., nv, nv)."""
    names, at = robot().joint_names, robot().topology.joint_v
    both = [[at[names.index(n)], at[names.index(f"{n}_roll")]] for n in grasp.LEADERS]
    parts = [np.asarray(covariance, np.float64)[..., pair, :][..., pair].sum(axis=(-2, -1)) for pair in both]
    return np.asarray(np.sqrt(np.maximum(np.stack(parts, axis=-1), 0)))


def finger_angles(q: NDArray[Any]) -> NDArray[np.float64]:
    """Return q1, q2, q3 of both fingers (..., 6), rad: each joint's two halves together."""
    names = robot().joint_names
    at = [robot().topology.joint_q[names.index(n)] for n in grasp.LEADERS]
    roll = [robot().topology.joint_q[names.index(f"{n}_roll")] for n in grasp.LEADERS]
    q = np.asarray(q, np.float64)
    return np.asarray(q[..., at] + q[..., roll])


__all__ = ["EDGES", "REDUNDANT", "Trial", "finger_angles", "finger_deviations", "joints", "pairs", "robot", "trial"]
