"""Functional calibration: joint axes in both sensors' frames from 20 s of motion, IMUs mounted any way."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.calibration import mounting
from jaxest.filters import attitude
from jaxest.io.report import Row
from jaxest.manifolds import quaternion as quat
from jaxest.reproduce import Choice, Say, Section
from jaxest.simulate import imu, trajectories

RUNS = 100
BATCH = 10
SECONDS, RATE_HZ = 20.0, 100.0
FIRST, SECOND = np.array([0, 1.0, 0]), np.array([1, 0, 0.3]) / np.linalg.norm([1, 0, 0.3])


def calibration(choice: Choice, say: Say) -> Section:
    """Mount two IMUs any way on the links of a hinge and of a two-axis joint, on a base that turns; find the axes."""
    count = choice.runs or (2 if choice.small else RUNS)
    rows: list[Row] = []
    for two, name in ((False, "hinge"), (True, "two-axis joint")):
        errors = []
        for begin in range(0, count, BATCH):
            say(f"calibration: {name}, mounting {begin + 1} of {count}")
            keys = jax.random.split(jax.random.key(choice.seed + begin + 50000 * two), min(BATCH, count - begin))
            errors += _errors(two, keys)
        worst = np.max(errors, axis=1)
        rows += [
            Row("error of an axis, mean", name, float(np.mean(errors)), "deg", float(np.std(errors)), count),
            Row("error of an axis, largest", name, float(worst.max()), "deg", n=count),
            Row("mountings with both axes within 1 deg", name, 100 * float(np.mean(worst < 1)), "%", n=count),
        ]
    return Section("calibration", "joint axes from 20 s of motion, random mountings", rows)


def joint(two: bool) -> str:
    """Write two links on a base that turns, with a hinge about y or a joint about y and then about (1, 0, 0.3)."""
    second = '<joint axis="1 0 0.3" range="-60 60"/>' if two else ""
    link = '<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.3"/>'
    return f"""<mujoco><compiler autolimits="true"/><worldbody><body>
      <joint axis="0 0 1" range="-90 90"/><joint axis="0 1 0" range="-60 60"/><joint axis="1 0 0" range="-60 60"/>
      {link}<site name="one" pos="0.1 0.02 0"/>
      <body pos="0.25 0 0"><joint axis="0 1 0" range="-70 70"/>{second}{link}<site name="two" pos="0.1 0.02 0"/></body>
      </body></worldbody></mujoco>"""


def _errors(two: bool, keys: Any) -> list[tuple[float, float]]:
    robot = kinematics.load(joint(two))

    def draw(key: Any) -> Any:
        turn, move, read = jax.random.split(key, 3)
        mounted = jax.vmap(quat.normalize)(jax.random.normal(turn, (2, 4)))
        motion = trajectories.random_motion(move, robot, slowest=0.1, fastest=0.7, reach=0.9)
        measurements, _ = imu.record_all(
            robot, lambda t: trajectories.configuration(motion, t), ("site:one", "site:two"), key=read,
            duration=SECONDS, rate_hz=RATE_HZ, mounting=mounted,
        )  # fmt: skip
        return mounted, measurements

    mounted, measurements = jax.jit(jax.vmap(draw))(keys)
    paths = np.asarray(_smoothed(measurements))
    time = np.arange(paths.shape[2]) / RATE_HZ
    found = []
    for k in range(len(paths)):
        solved = (mounting.two_axis if two else mounting.hinge)(time, paths[k, 0], paths[k, 1])
        truth = [np.asarray(quat.rotate(quat.inverse(mounted[k, i]), jnp.asarray(axis, jnp.float32)), float)
                 for i, axis in enumerate((FIRST, SECOND if two else FIRST))]  # fmt: skip
        pair = [_between(a, b) for a, b in zip((solved.first, solved.second), truth, strict=True)]
        if not two and (solved.first @ truth[0]) * (solved.second @ truth[1]) < 0:
            pair[1] = 180 - pair[1]  # the two must be of one sign
        found.append((pair[0], pair[1]))
    return found


@jax.jit
def _smoothed(measurements: Any) -> Any:
    """Smoothed orientations (runs, 2, T, 4) of measurements (runs, T, 2, ...)."""
    params = jax.tree.map(np.float32, attitude.ekf.Params())

    def one(measurements: Any) -> Any:
        return attitude.smooth(params, attitude.ekf.init(params), measurements, block=3).quaternion

    flat = measurements._replace(magnetometer=None)
    axes = type(flat)(type(flat.gyroscope)(1, 1), type(flat.gyroscope)(1, 1), None, None)
    return jax.vmap(jax.vmap(one, (axes,)))(flat)


def _between(a: Any, b: Any) -> float:
    return float(np.rad2deg(np.arccos(np.clip(abs(a @ b), 0, 1))))


__all__ = ["calibration", "joint"]
