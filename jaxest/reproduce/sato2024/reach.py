"""Fig. 8: a manipulator of sticks measures itself, reaches over a box and drops a ball; then it is rebuilt."""

import functools
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from jaxest import kinematics
from jaxest.calibration import imu, imu_static, tumble
from jaxest.filters import run
from jaxest.io.report import Row
from jaxest.kinematics import modular
from jaxest.reproduce import Choice, Say, Section
from jaxest.simulate import manipulator
from jaxest.systems import onsite_chain
from jaxest.systems.onsite_recording import Imu
from jaxest.types import OK, InputError
from jaxest.viz import canvas

PAPER = {"assembly 1": 47.0, "assembly 2": 33.0}  # s of excitation
SECONDS = 60.0  # of swinging that is recorded; the estimate stops by itself
STEPS = 5120  # of the filter, padded, so that all assemblies share a program
KINDS = ("gyroscope", "accelerometer")
SITE = f"site:{modular.TOOL}"


class Reach(NamedTuple):
    """What became of one assembly."""

    excitation: float
    """s of swinging until every link was known; NaN where that was never."""
    position: NDArray[np.float64]
    """(L,) mm, errors of the links' ends"""
    rotation: NDArray[np.float64]
    """(L,) deg"""
    distance: float
    """mm, gripper to target by the true kinematics"""
    sagging: float
    """mm, gripper to target as it hangs on its servos"""
    inside: bool
    """whether the ball lies in the box"""
    time: NDArray[np.float64]
    """(T,) s since the swinging began"""
    poses: NDArray[np.float64]
    """(T, L, 3) m, estimated positions"""
    spread: NDArray[np.float64]
    """(T, L, 2) rad, m: two standard deviations"""
    truth: NDArray[np.float64]
    """(L, 3) m"""


def fig8(choice: Choice, say: Say) -> Section:
    """Measure, reach, drop, take apart, rebuild, and again.

    Source: Sato 2024, section IV-C, Figs. 7 and 8.
    """
    runs = 1 if choice.small else choice.runs or 2
    done = []
    for i in range(runs):
        say(f"fig. 8: assembly {i + 1} of {runs}")
        done.append(once(1000 * choice.seed + i, seconds=12.0 if choice.small else SECONDS))
    rows: list[Row] = []
    for i, one in enumerate(done[:2]):
        name = f"assembly {i + 1}"
        rows += [
            Row("excitation", name, _known(one.excitation), "s", reference=PAPER[name], reference_name="paper"),
            Row("link's end, worst error", name, float(one.position.max()), "mm"),
            Row("link's direction, worst error", name, float(one.rotation.max()), "deg"),
            Row("gripper to target", name, _known(one.distance), "mm"),
            Row("ball in the box", name, float(one.inside), "1", reference=1.0, reference_name="paper"),
        ]
    if runs > 2:
        rows += _all(done)

    def paint(figure: Any) -> None:
        _paint(figure, done[:2])

    title = "Fig. 8: links measured while one joint after the other swings"
    return Section("fig8", title, rows, lambda path: canvas.save(path, (11, 7), paint, title))


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _all(done: list[Reach]) -> list[Row]:
    n, name = len(done), f"{len(done)} assemblies"
    times = np.array([one.excitation for one in done])
    distance = np.array([one.distance for one in done])
    known = times[np.isfinite(times)]
    return [
        Row("stopped by themselves", name, float(len(known)), "1", n=n, reference=float(n), reference_name="all"),
        Row("excitation, median", name, float(np.median(known)) if len(known) else None, "s", n=n),
        Row("excitation, longest", name, float(known.max()) if len(known) else None, "s", n=n),
        Row("gripper to target, median", name, _known(float(np.median(distance))), "mm", n=n),
        Row("gripper to target, worst", name, _known(float(distance.max())), "mm", n=n),
        Row("gripper to target with the servos' sag, worst", name, _known(max(one.sagging for one in done)), "mm", n=n),
        Row("link's end, worst error", name, max(float(one.position.max()) for one in done), "mm", n=n),
        Row("link's direction, worst error", name, max(float(one.rotation.max()) for one in done), "deg", n=n),
        Row("balls in the box", name, float(sum(one.inside for one in done)), "1", n=n),
    ]  # fmt: skip


@functools.cache
def _system() -> Any:
    """The estimator; all assemblies of the simulation have the same modules."""
    return onsite_chain.build(manipulator.draw(0).assembly)


@jax.jit
def _follow(params: Any, samples: Any) -> Any:
    system = _system()
    return run(system.step, params, system.init(params), samples)[1]


def measured(sticks: manipulator.Sticks, seed: int, seconds: float) -> tuple[NDArray[np.float64], onsite_chain.Info]:
    """Calibrate the modules' IMUs on a plate, swing the joints and follow the estimate.

    Args:
        sticks: the manipulator.
        seed: of joints and sensors.
        seconds: of swinging.

    Returns:
        Times since the swinging began (T,), s, and the estimates, NumPy leaves (T, ...).
    """
    recorded = manipulator.swing(sticks, seed, seconds=seconds)
    blocks = [[tumble.calibrate(one, flatness=manipulator.FLATNESS) for one in link] for link in recorded.tumbled]
    links = [
        tuple(
            Imu(recorded.time[k][e], *imu.apply(blocks[k][e], recorded.gyroscope[k][e], recorded.accelerometer[k][e]))
            for e in (0, 1)
        )
        for k in range(len(sticks.links))
    ]
    rests = [[imu_static.calibrate(*one[:3]) for one in link] for link in links]
    time, samples = onsite_chain.samples(links)  # type: ignore[arg-type]
    begun = time >= manipulator.REST
    count = int(begun.sum())
    kept = jax.tree.map(lambda x: _padded(np.asarray(x)[begun]), samples)
    noise = np.sqrt(np.mean([np.trace(r.gyroscope_covariance) / 3 for link in rests for r in link]))
    params = _system().default_params
    axes = {f"{kind}_axes": max(getattr(c, f"{kind}_axes") for link in blocks for c in link) for kind in KINDS}
    pair = params.pair._replace(gyroscope_noise=noise, gyroscope_bias=0.003, **axes)
    params = params._replace(pair=pair, bias=np.array([[r.gyroscope_bias for r in link] for link in rests]))
    params = jax.tree.map(lambda x: np.asarray(x, np.float32), params)
    info = jax.tree.map(lambda x: np.asarray(x)[:count], _follow(params, kept))
    return time[begun] - manipulator.REST, info


def _padded(x: NDArray[Any]) -> NDArray[Any]:
    """Cut or fill up to the filter's number of steps; what is filled in is not valid."""
    x = x.astype(np.float32) if x.dtype.kind == "f" else x
    return np.pad(x, [(0, max(STEPS - len(x), 0)), *((0, 0),) * (x.ndim - 1)])[:STEPS]


@jax.jit
def _solve(robot: kinematics.Robot, target: Any, key: Any) -> kinematics.Solution:
    aim = {SITE: kinematics.Target(target)}
    return kinematics.search_inverse_kinematics(robot, aim, robot.home, key=key, starts=16, tolerance=1e-4)


def once(seed: int, *, seconds: float = SECONDS) -> Reach:
    """Put an assembly together, measure it, reach and drop.

    Args:
        seed: of everything.
        seconds: of swinging at most.

    Returns:
        What became of it.
    """
    sticks = manipulator.draw(seed)
    time, info = measured(sticks, seed, seconds)
    stop = int(np.argmax(info.done)) if info.done.any() else -1
    final = jax.tree.map(lambda x: x[stop], info)
    true = modular.assemble(sticks.assembly, sticks.links)
    target, box = _placed(true, seed)
    places = np.stack([link.translation for link in sticks.links])
    turns = np.stack([link.rotation for link in sticks.links])
    position = 1e3 * np.linalg.norm(final.position - places, axis=1)
    rotation = _angles(np.asarray(final.quaternion, float), turns)
    excitation = float(time[stop]) if info.done.any() else np.nan
    partial_reach = partial(
        Reach,
        excitation,
        position,
        rotation,
        time=time,
        poses=np.asarray(info.position),
        spread=np.asarray(info.spread),
        truth=places,
    )
    try:
        found = onsite_chain.rebuild(sticks.assembly, final)
    except InputError:
        return partial_reach(np.nan, np.nan, False)
    solution = _solve(_single(found), target.astype(np.float32), jax.random.key(seed))
    if int(solution.status) != OK:
        return partial_reach(np.nan, np.nan, False)
    q = np.asarray(solution.q, float)
    distance = 1e3 * float(np.linalg.norm(_tool(true, q) - target))
    dropped = manipulator.drop(sticks, q, box)
    return partial_reach(distance, 1e3 * float(np.linalg.norm(dropped.gripper - target)), dropped.inside)


def _angles(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles in degrees between quaternions (n, 4), by their chord: an arc cosine loses half the digits near 1."""
    one = one / np.linalg.norm(one, axis=1, keepdims=True)
    apart = np.minimum(*(np.linalg.norm(one - sign * other, axis=1) for sign in (1, -1)))
    return np.rad2deg(4 * np.arcsin(np.minimum(apart / 2, 1)))


def _single(robot: kinematics.Robot) -> kinematics.Robot:
    single: kinematics.Robot = jax.tree.map(lambda x: np.asarray(x, np.float32), robot)
    return single


@jax.jit
def _stand(robot: kinematics.Robot, q: Any) -> Any:
    return kinematics.forward(robot, q, (SITE,)).position[0]


def _tool(robot: kinematics.Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(_stand(_single(robot), q.astype(np.float32)), float)


def _placed(robot: kinematics.Robot, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A target (3,) within reach, as one finds out by moving the robot like a puppet, and the box below it (3,)."""
    random = np.random.default_rng([seed, 2])
    low, high = np.asarray(robot.limits).T
    while True:
        target = _tool(robot, random.uniform(0.8 * low, 0.8 * high))
        if 0.1 < target[2] < 0.6 and np.linalg.norm(target[:2]) > 0.2:
            return target, target - [0, 0, manipulator.ABOVE + manipulator.BOX[2]]


def _paint(figure: Any, done: list[Reach]) -> None:
    axes = figure.subplots(4, len(done), squeeze=False, sharex="col")
    for column, one in enumerate(done):
        for link in range(2):
            axis = canvas.plain(axes[link, column], ylabel=f"link {link + 1} [mm]" if column == 0 else "")
            for k, colour in enumerate((canvas.RED, canvas.GREEN, canvas.BLUE)):
                axis.plot(one.time, 1e3 * one.poses[:, link, k], color=colour, linewidth=1.1, label="xyz"[k])
                axis.axhline(1e3 * one.truth[link, k], color=colour, linestyle="--", linewidth=0.8)
            axis.set_ylim(-350, 350)
            axis.plot([], [], color=canvas.GREY, linestyle="--", linewidth=0.8, label="true")
        for row, (part, scale, limit, label) in enumerate(
            ((1, 1e3, 5, "position, 95 % [mm]"), (0, np.rad2deg(1), 0.1, "rotation, 95 % [deg]"))
        ):
            axis = canvas.plain(axes[2 + row, column], ylabel=label if column == 0 else "")
            for link, colour in enumerate((canvas.BLUE, canvas.ORANGE)):
                value = np.where(one.spread[:, link, part] > 0, scale * one.spread[:, link, part], np.nan)
                axis.semilogy(one.time, value, color=colour, linewidth=1.1, label=f"link {link + 1}")
            axis.axhline(limit, color=canvas.GREY, linestyle="--", linewidth=0.9, label=f"done below {limit:g}")
        for axis in axes[:, column]:
            axis.axvline(one.excitation, color=canvas.RED, linewidth=0.9)
        done_after = f"done after {one.excitation:.1f} s" if np.isfinite(one.excitation) else "not done"
        axes[0, column].set_title(
            f"assembly {column + 1}: {done_after}, gripper {one.distance:.1f} mm off", fontsize=10
        )
        axes[3, column].set_xlabel("time since the swinging began [s]")
    axes[0, 0].legend(fontsize=8, frameon=False, ncols=4)
    for row in (2, 3):
        axes[row, 0].legend(fontsize=8, frameon=False, ncols=3)


__all__ = ["Reach", "fig8", "measured", "once"]
