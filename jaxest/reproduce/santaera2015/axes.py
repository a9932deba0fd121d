"""Functional calibration: joint axes in both sensors' frames from 20 s of motion, IMUs mounted any way."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.calibration import mounting
from jaxest.filters import attitude
from jaxest.io.report import Row
from jaxest.manifolds import quaternion as quat
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.santaera2015 import kept
from jaxest.simulate import imu, trajectories
from jaxest.viz import canvas

RUNS = 100
BATCH = 10
SECONDS, RATE_HZ = 20.0, 100.0
FIRST, SECOND = np.array([0, 1.0, 0]), np.array([1, 0, 0.3]) / np.linalg.norm([1, 0, 0.3])


def calibration(choice: Choice, say: Say) -> Section:
    """Mount two IMUs any way on the links of a hinge and of a two-axis joint, on a base that turns; find the axes."""
    count = choice.runs or (2 if choice.small else RUNS)
    rows: list[Row] = []
    shown = {}
    for two, name in ((False, "hinge"), (True, "two-axis joint")):
        errors = []
        for begin in range(0, count, BATCH):
            say(f"calibration: {name}, mounting {begin + 1} of {count}")
            seed, size = seed_of(choice, begin + 50000 * two), min(BATCH, count - begin)
            made = kept.piece(choice.work, f"axes_{1 + two}_{seed}_{size}", partial(_errors, two, seed, size))
            errors.append(made["error"])
        *both, foreseen = np.concatenate(errors).T
        worst = shown[name] = np.max(both, axis=0)
        rows += [
            Row("error of an axis, mean", name, float(np.mean(both)), "deg", float(np.std(both)), count),
            Row("error of an axis, largest", name, float(worst.max()), "deg", n=count),
            Row("mountings with both axes within 1 deg", name, 100 * float(np.mean(worst < 1)), "%", n=count),
            Row("squared error over its variance", name, float(foreseen.mean()), "1", float(foreseen.std()), count, 1.0,
                "an honest covariance"),
        ]  # fmt: skip

    def paint(path: Path) -> None:
        canvas.save(path, (7, 3.5), lambda figure: _paint(figure, shown), "Joint axes found from 20 s of motion")

    return Section("calibration", "joint axes from 20 s of motion, random mountings", rows, paint)


def _paint(figure: Any, shown: dict[str, Any]) -> None:
    """Share of the mountings whose worse axis is off by no more than an angle."""
    axis = figure.subplots()
    for (name, worst), color in zip(shown.items(), (canvas.BLUE, canvas.ORANGE), strict=True):
        share = 100 * np.arange(1, len(worst) + 1) / len(worst)
        axis.step(np.sort(worst), share, where="post", color=color, label=f"{name}, {len(worst)} mountings")
    axis.axvline(1.0, color=canvas.RED, linewidth=0.9, label="1 deg asked")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_ylim(0, 105)
    canvas.plain(axis, xlabel="error of the worse of both axes [deg]", ylabel="mountings within it [%]")
    axis.legend(fontsize=8, frameon=False)


def joint(two: bool) -> str:
    """Write two links on a base that turns, with a hinge about y or a joint about y and then about (1, 0, 0.3)."""
    second = '<joint axis="1 0 0.3" range="-60 60"/>' if two else ""
    link = '<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.3"/>'
    return f"""<mujoco><compiler autolimits="true"/><worldbody><body>
      <joint axis="0 0 1" range="-90 90"/><joint axis="0 1 0" range="-60 60"/><joint axis="1 0 0" range="-60 60"/>
      {link}<site name="one" pos="0.1 0.02 0"/>
      <body pos="0.25 0 0"><joint axis="0 1 0" range="-70 70"/>{second}{link}<site name="two" pos="0.1 0.02 0"/></body>
      </body></worldbody></mujoco>"""


def _errors(two: bool, seed: int, size: int) -> kept.Arrays:
    """Errors (size, 3), as `_compared` has them."""
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

    mounted, measurements = jax.jit(jax.vmap(draw))(jax.random.split(jax.random.key(seed), size))
    paths = np.asarray(_smoothed(measurements))
    time, rate = np.arange(paths.shape[2]) / RATE_HZ, np.asarray(measurements.gyroscope.value, np.float64)
    found = []
    for k in range(len(paths)):
        rates = rate[k, :, 0], rate[k, :, 1]
        solved = (mounting.two_axis if two else mounting.hinge)(time, paths[k, 0], paths[k, 1], rates=rates)
        truth = [np.asarray(quat.rotate(quat.inverse(mounted[k, i]), jnp.asarray(axis, jnp.float32)), float)
                 for i, axis in enumerate((FIRST, SECOND if two else FIRST))]  # fmt: skip
        found.append(_compared(solved, truth, two))
    return {"error": np.array(found)}


def _compared(solved: mounting.Axes, truth: list[Any], two: bool) -> tuple[float, float, float]:
    """Errors of both axes in degrees, and the mean of their squared errors over what their covariances foresee."""
    first = np.sign(solved.first @ truth[0])
    signs = first, np.sign(solved.second @ truth[1]) if two else first  # a hinge's two must be of one sign
    errors, sizes = [], []
    for k, (axis, true, sign) in enumerate(zip((solved.first, solved.second), truth, signs, strict=True)):
        errors.append(float(np.rad2deg(np.arccos(np.clip(sign * axis @ true, -1, 1)))))
        spread = np.linalg.pinv(solved.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], rcond=1e-6, hermitian=True)
        off = axis - sign * true
        sizes.append(float(off @ spread @ off) / 2)
    return errors[0], errors[1], sum(sizes) / 2


@jax.jit
def _smoothed(measurements: Any) -> Any:
    """Smoothed orientations (runs, 2, T, 4) of measurements (runs, T, 2, ...)."""
    params = jax.tree.map(np.float32, attitude.ekf.Params())

    def one(measurements: Any) -> Any:
        return attitude.smooth(params, attitude.ekf.init(params), measurements, block=3).quaternion

    flat = measurements._replace(magnetometer=None)
    axes = type(flat)(type(flat.gyroscope)(1, 1), type(flat.gyroscope)(1, 1), None, None)
    return jax.vmap(jax.vmap(one, (axes,)))(flat)


__all__ = ["calibration", "joint"]
