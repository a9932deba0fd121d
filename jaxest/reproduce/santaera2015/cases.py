"""Figs. 5 to 8: the gripper at rest, closing on nothing, with a phalanx pushed, and with its palm turned."""

from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.filters import complementary, every, run
from jaxest.io.report import Row
from jaxest.kinematics import roll_pitch_yaw
from jaxest.manifolds import quaternion as quat
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.santaera2015 import hand, kept
from jaxest.reproduce.santaera2015.table import draw_gripper
from jaxest.simulate import grasp
from jaxest.types import Reading
from jaxest.viz import canvas

SCENES = {
    "rest (fig. 5)": grasp.Scene(tension=0.0),
    "free closing (fig. 6)": grasp.Scene(tension=0.5),
    "pushed phalanx (fig. 7)": grasp.Scene(tension=0.3, push=(0.0, 0.6, 0.0)),
    "palm rolled and pitched (fig. 8)": grasp.Scene(tension=0.3, turn=(0.5, 0.35, 0.0)),
}
RUNS = 10


def cases(choice: Choice, say: Say) -> Section:
    """Follow the gripper through the paper's cases by pairs of 6-axis IMUs.

    The joint angles come from all edges; the redundant pair's q1 + q2 is compared with the sum of the two.

    Source: Santaera 2015, figs. 5 to 8, section V.
    """
    count = choice.runs or (1 if choice.small else RUNS)
    rows: list[Row] = []
    shown: dict[str, Any] = {}
    for name, scene in SCENES.items():
        say(f"cases: {name}")
        tag = f"cases_{name.split()[0]}_{seed_of(choice)}_{count}"
        made = kept.piece(choice.work, tag, partial(_case, scene, seed_of(choice), count))
        each = np.sqrt(np.mean(made["error"] ** 2, axis=(1, 2)))
        rows += [
            Row("finger angles, RMSE", name, float(each.mean()), "deg", float(each.std()), count),
            Row("finger angles, largest error", name, float(np.abs(made["error"]).max()), "deg", n=count),
            Row("q* against q1 + q2, rms", name, float(np.sqrt(np.mean(made["apart"] ** 2))), "deg", n=count),
        ]
        shown[name] = made
    say("cases: roll and pitch of the palm")
    made = kept.piece(choice.work, f"cases_imu7_{seed_of(choice)}_{count}", partial(_palm, seed_of(choice), count))
    rows += [
        Row(f"{part} of the palm, RMSE", "fig. 8, IMU 7 alone", float(size.mean()), "deg", float(size.std()), count)
        for part, size in zip(("roll", "pitch"), made["size"].T, strict=True)
    ]

    def draw(path: Path) -> None:
        canvas.save(path, (12, 5.5), lambda figure: _paint(figure, shown), "Figs. 5 to 8: estimate and truth")

    return Section("cases", "Figs. 5 to 8: the gripper's cases", rows, draw)


def _case(scene: grasp.Scene, seed: int, count: int) -> kept.Arrays:
    """Perform a scene some times: errors, deg, and what a picture shows of the first."""
    trials = [hand.trial(scene, seed + 1000 + k) for k in range(count)]
    error, (rotations, q) = angle_errors(trials)
    apart = np.rad2deg([np.asarray(redundancy(each)) for each in rotations])
    first = trials[0].found
    return {"error": error, "apart": apart, "q": q[0], "time": first.time[19::20], "truth": first.q[19::20],
            "end": first.q[-1]}  # fmt: skip


def angle_errors(trials: list[hand.Trial], *, magnetic: bool = False) -> tuple[NDArray[np.float64], Any]:
    """Return errors of the six finger angles (trials, T, 6), deg, and the edges' rotations and joints, every 20 ms."""
    info = hand.pairs(trials, every(20), magnetic=magnetic)
    rotations = np.asarray(info.value.quaternion)
    flat = rotations.reshape(-1, *rotations.shape[2:])
    mountings = np.repeat(np.stack([t.mounting for t in trials]), rotations.shape[1], axis=0)
    q = np.asarray(hand.joints(flat, mountings).q, np.float64).reshape(*rotations.shape[:2], -1)
    truth = np.stack([t.found.q[19::20][: rotations.shape[1]] for t in trials])
    return np.rad2deg(hand.finger_angles(q) - hand.finger_angles(truth)), (rotations, q)


@jax.jit
def redundancy(rotations: Any) -> Any:
    """Return the angle between the rotation of IMU 1 and 3 and that by way of IMU 2, rad: (T, 8, 4) to (T, 2)."""

    def one(r: Any) -> Any:
        around = [quat.local(quat.compose(r[a], r[b]), r[c]) for a, b, c in ((1, 2, 3), (5, 6, 7))]
        return jnp.stack([jnp.sqrt(jnp.sum(v * v)) for v in around])

    return jax.vmap(one)(rotations)


def _palm(seed: int, count: int) -> kept.Arrays:
    """Errors (count, 2) of the palm's roll and pitch, rms in deg, from IMU 7 alone by the complementary filter."""
    errors = []
    for k in range(count):
        trial = hand.trial(SCENES["palm rolled and pitched (fig. 8)"], seed + 2000 + k)
        used = trial.measurements._replace(magnetometer=None)
        gyro, acc = (Reading(*(x[:, 6] for x in reading)) for reading in (used.gyroscope, used.accelerometer))
        one = used._replace(gyroscope=gyro, accelerometer=acc)
        gains = complementary.Params(*(np.float32(x) for x in (1.0, 0.01, 1.0, 1.0)))
        _, info = run(complementary.step, gains, complementary.init(gains), one)
        mounted = jnp.asarray(trial.mounting[6], jnp.float32)
        found = jax.vmap(lambda q, m=mounted: quat.compose(q, quat.inverse(m)))(info.quaternion)
        truth = jnp.asarray(trial.found.quaternion[:, 6], jnp.float32)  # the site is parallel to the palm
        angles = [np.stack(jax.vmap(roll_pitch_yaw)(q)[:2], axis=1) for q in (found, truth)]
        errors.append(np.rad2deg(angles[0] - angles[1]))
    return {"size": np.sqrt(np.mean(np.square(errors), axis=1))}


def _paint(figure: Any, shown: dict[str, Any]) -> None:
    axes = figure.subplots(2, len(shown), height_ratios=(2, 1))
    for axis in axes[0, 1:]:
        axis.sharex(axes[0, 0])  # one scale for all grippers
        axis.sharey(axes[0, 0])
    for column, (name, made) in enumerate(shown.items()):
        q, true = made["q"], np.array(made["end"])
        estimated = np.array(q[-1])
        estimated[:4] = true[:4] = (1, 0, 0, 0)
        top = axes[0, column]
        draw_gripper(top, true, canvas.RED)
        draw_gripper(top, estimated, canvas.BLUE)
        canvas.plain(top, xlabel="across [mm]")
        top.set_title(name, fontsize=10)
        top.set_aspect("equal")
        time = made["time"][: len(q)]
        found, truth = (np.rad2deg(hand.finger_angles(x)) for x in (q, made["truth"][: len(q)]))
        bottom = axes[1, column]
        for joint in range(3):
            named = joint == 0 and column == 0  # a legend has each once
            bottom.plot(time, truth[:, joint], color=canvas.RED, linewidth=2, label="truth" if named else None)
            bottom.plot(time, found[:, joint], color=canvas.BLUE, linewidth=0.9, label="estimate" if named else None)
        canvas.plain(bottom, xlabel="time [s]")
    axes[0, 0].set_ylabel("above the palm [mm]")
    axes[1, 0].set_ylabel("q1, q2, q3 left [deg]")
    axes[1, 0].legend(fontsize=8, frameon=False)


__all__ = ["angle_errors", "cases", "redundancy"]
