"""One run of one condition: a room, a motion, readings, an estimate, its figures."""

import atexit
import functools
import json
import multiprocessing
import os
import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.files import write_text
from jaxest.filters import run
from jaxest.io import pieces
from jaxest.manifolds import quaternion
from jaxest.reproduce.iwao2025.conditions import CHAIN, Condition
from jaxest.sensors.proximity import Proximity, tilted
from jaxest.simulate import boxes, proximity, rooms
from jaxest.systems import slam, slam_chain
from jaxest.types import Reading, System

BIAS = 0.05
CODE = (*pieces.ESTIMATE, "reproduce/iwao2025")
NEAR = 0.05  # m, map points this near to a surface are right


class Plan(NamedTuple):
    """What a run needs to be told, beside its condition."""

    seed: int
    seconds: float
    dt: float = 0.1


class Made(NamedTuple):
    """A simulated run."""

    room: rooms.Room
    sensors: tuple[Proximity, ...]
    """As they are believed to look."""
    scan: proximity.Scan


def scans(folder: Path | None, name: str) -> Path:
    """Return the file that keeps a simulation; without a folder it is kept until this run ends."""
    parent = multiprocessing.parent_process()
    place = folder or for_now(parent.pid if parent and parent.pid else os.getpid())
    return pieces.folder(place / "scans", pieces.SIMULATION) / f"{name}.npz"


@functools.cache
def for_now(owner: int) -> Path:
    """Return the folder of a run without one, named by the process `owner`, which takes it away at its end.

    It does so if it has called this itself, whether or not its workers did.
    """
    path = Path(tempfile.gettempdir()) / f"jaxest-iwao2025-{owner}"
    if owner == os.getpid():
        atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def simulated(one: Condition, plan: Plan, folder: Path | None) -> Made:
    """Draw the room and the motion of a seed and cast the rays, or read them if that was done before."""
    room = rooms.room(plan.seed, reach=(one.links + 1) * rooms.LENGTHS.get(one.links, 0.17))
    believed = rooms.sensors(one.links, rows=one.rows, columns=one.columns)
    tag = f"{one.links}_{one.rows}x{one.columns}_{one.tilt_deg:g}_{plan.seed}_{plan.seconds:g}s"
    path = scans(folder, tag)
    if path.is_file():
        return Made(room, believed, proximity.load(path))
    model = proximity.compiled(rooms.scene(one.links, room))
    time, q = proximity.inside(model, plan.seed, duration=plan.seconds, dt=plan.dt)
    random = np.random.default_rng([plan.seed, 7006])
    axes = random.normal(size=(len(believed), 3))
    angles = np.deg2rad(one.tilt_deg) * random.uniform(0, 1, len(believed))
    real = tilted(believed, angles, axes / np.linalg.norm(axes, axis=1, keepdims=True)) if one.tilt_deg else believed
    scan = proximity.cast(model, real, q, time)
    proximity.save(scan, path)
    return Made(room, believed, scan)


def measurements(one: Condition, plan: Plan, made: Made) -> slam.Fixed:
    """Add noise to a scan's ranges and a bias to its joints."""
    faults = proximity.Faults(noise=one.noise, bias=BIAS)
    ranges, there = proximity.corrupt(made.scan, made.sensors, faults, plan.seed)
    angles = made.scan.q[:, -one.links :]
    joints = proximity.encoders(angles, faults, plan.seed).astype(np.float32)
    steps = np.full(len(joints), plan.dt, np.float32)
    present = np.ones(joints.shape, bool)
    return slam.Fixed(Reading(ranges, there), Reading(joints, present), steps)  # type: ignore[arg-type]


@functools.cache
def system(
    links: int, rows: int, columns: int, chain: bool = False, free: bool = False, align: bool = False
) -> tuple[Any, System]:
    """Return the structure and its filter, built once."""
    robot = kinematics.load(rooms.structure(links, free=free))
    build: Any = slam_chain.build if chain else partial(slam.build, align=align)
    return robot, build(robot, rooms.sensors(links, rows=rows, columns=columns))


def told(one: Condition, params: Any, chain: bool = False) -> Any:
    """Return parameters that know the noise and how far sensors may be tilted."""
    if chain:
        level = {0.01: 0.002, 0.02: 0.003, 0.05: 0.005, 0.07: 0.01}[one.noise]
        params = params._replace(variance=level)
    else:
        # Uniform up to the largest angle about an axis in any direction is a third of it about each.
        tilt = np.deg2rad(one.tilt_deg) / 3
        # The paper's encoders are off by a constant, and have no noise.
        params = params._replace(noise=one.noise / proximity.SIGMAS, tilt=tilt, encoder=0.0)
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)


class Found(NamedTuple):
    """What the filter made of a run, on the host."""

    position: np.ndarray
    """(T, B, 3) m."""
    truth: np.ndarray
    """(T, B, 3) m."""
    turned: np.ndarray
    """(T, B, 3) rad, rotation from the true to the estimated link, along the world's axes."""
    blind: np.ndarray
    """(T, B, 3) m, by encoders alone."""
    info: Any
    state: Any


def poses(robot: Any, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (T, B, 3) and quaternions (T, B, 4) of all bodies."""
    frames = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q)))(q.astype(np.float32))
    return np.asarray(frames.position), np.asarray(frames.quaternion)


def estimated(one: Condition, plan: Plan, made: Made, chain: bool = False) -> Found:
    """Run the filter over a simulated run."""
    robot, built = system(one.links, one.rows, one.columns, chain, align=one.tilt_deg > 0)
    given = measurements(one, plan, made)
    params = told(one, built.default_params, chain)
    state, info = jax.block_until_ready(run(built.step, params, built.init(params), given))
    truth, stood = poses(robot, made.scan.q)
    blind, _ = poses(robot, np.asarray(given.joints.value))
    turned = _turned(np.asarray(info.quaternion), stood)
    return Found(np.asarray(info.position), truth, turned, blind, info, state)


def _turned(q: np.ndarray, truth: np.ndarray) -> np.ndarray:
    away = jax.jit(jax.vmap(lambda a, b: quaternion.log(quaternion.compose(a, quaternion.inverse(b)))))
    return np.asarray(away(q.reshape(-1, 4), truth.reshape(-1, 4))).reshape(*q.shape[:-1], 3)


def figures(one: Condition, made: Made, found: Found, chain: bool) -> dict[str, Any]:
    """Return the figures of a run, as what JSON can keep."""
    error = 100 * np.linalg.norm(found.position - found.truth, axis=2)
    blind = 100 * np.linalg.norm(found.blind - found.truth, axis=2)
    links = [k for k in (5, 10, 20) if k <= one.links]
    out: dict[str, Any] = {
        "mean": {str(k): float(error[:, k].mean()) for k in links},
        "worst": float(error[:, one.links].max()),
        "settled": float(error[len(error) // 3 :, one.links].max()),
        "blind": {str(k): float(blind[:, k].mean()) for k in links},
        "finite": bool(np.isfinite(error).all()),
    }
    chart = found.state.chart
    points = np.asarray(chart.point)[: int(chart.used)]
    far = np.asarray(boxes.surface(_boxes(made.room), jnp.asarray(points)))
    out["map"] = float((far < NEAR).mean())
    out["voxels"] = len(points)
    bias = np.asarray(found.info.bias)
    if chain:
        deviation = np.sqrt(np.maximum(np.asarray(found.info.covariance)[:, 1:, 6, 6], 1e-12))
        out["nees_bias"] = (((bias[:, 1:] - BIAS) / deviation) ** 2).mean(0).tolist()
    else:
        deviation = np.asarray(found.info.bias_deviation)
        out["nees_bias"] = (((bias - BIAS) / deviation) ** 2).mean(0).tolist()
        covariance = np.asarray(found.info.pose_covariance)[:, 1:]
        error = np.concatenate([found.turned, found.position - found.truth], axis=2)[:, 1:]
        out["nees_pose"] = nees(error, covariance).mean(0).tolist()
        out["flagged"] = float(np.mean(np.asarray(found.info.status) == slam.LOST))
    return out


def nees(error: np.ndarray, covariance: np.ndarray, least: float = 3e-5) -> np.ndarray:
    """Return the normalised squared error per degree of freedom, over directions that can move.

    Args:
        error: (..., n) rad and m.
        covariance: (..., n, n).
        least: rad or m; a direction with a smaller deviation cannot move (a first link is bound to a circle).

    Returns:
        (...), 0 where no direction can move.
    """
    values, vectors = np.linalg.eigh(covariance.astype(float))
    along = np.einsum("...ij,...i->...j", vectors, error.astype(float))
    free = values > least**2
    parts = np.where(free, along**2 / np.where(free, values, 1), 0)
    return parts.sum(-1) / np.maximum(free.sum(-1), 1)


def _boxes(room: rooms.Room) -> boxes.Boxes:
    return boxes.Boxes(room.lower, room.upper, room.centers[6:], room.halves[6:])


def result(name: str, one: Condition, plan: Plan, folder: Path | None) -> dict[str, Any]:
    """Return the figures of a run, computed unless they were kept."""
    tag = "_".join(name.replace("%", "pc").replace("'", "").split())
    file = f"{tag}_{plan.seed}_{plan.seconds:g}s.json"
    path = None if folder is None else pieces.folder(folder / "runs", CODE) / file

    def compute() -> dict[str, Any]:
        made = simulated(one, plan, folder)
        return figures(one, made, estimated(one, plan, made, name == CHAIN), name == CHAIN)

    return pieces.made(path, compute, _read, lambda path, found: write_text(path, json.dumps(found), overwrite=True))


def _read(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text())
    if not isinstance(found, dict) or "mean" not in found:
        raise ValueError("it holds no figures of a run")
    return found


__all__ = [
    "BIAS", "Found", "Made", "Plan", "estimated", "figures", "for_now", "measurements", "nees", "result", "simulated",
]  # fmt: skip
