"""A 3-D recording for Rerun: the robot, how well it is known, particles and a map, on a time line."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxest import kinematics
from jaxest.files import replacing
from jaxest.io.extras import need
from jaxest.kinematics import Robot
from jaxest.manifolds import quaternion
from jaxest.types import InputError

SIGMAS = 2.8  # half axes of an ellipsoid that holds 95 % of a normal in three dimensions
INK, RED, GREY = (31, 78, 121), (209, 73, 91), (140, 140, 140)


def write(
    path: Path | str,
    robot: Robot,
    time: NDArray[np.float64],
    q: NDArray[np.float64],
    *,
    frames: tuple[str, ...] = (),
    covariance: NDArray[np.float64] | None = None,
    particles: NDArray[np.float64] | None = None,
    beside: NDArray[np.float64] | None = None,
    points: NDArray[np.float64] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a recording; `rerun FILE` opens it.

    Args:
        path: ends in `.rrd`.
        robot: the robot.
        time: (T,) s.
        q: (T, nq) its coordinates.
        frames: whose places are drawn with ellipsoids and particles; the last body if empty.
        covariance: (T, nv, nv) of the coordinates, in the tangent space; 95 % ellipsoids of the frames come from it.
        particles: (T, N, nq) coordinates of particles.
        beside: (T, nq) of a second robot, in red: the rigid model, or the truth.
        points: (n, 3) m, of a map.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: another suffix, rerun-sdk is not installed, the output exists, or a frame does not exist.
    """
    path = Path(path)
    if path.suffix.lower() != ".rrd":
        raise InputError(f"{path}: expected a name that ends in .rrd")
    rerun = need("rerun", "rerun", path)
    names = frames or (robot.frame_names[len(robot.topology.body_names) - 1],)
    for name in names:
        kinematics.frame(robot, name)
    place = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, names).position))
    tips, spread = np.asarray(place(q)), None if covariance is None else _ellipsoids(robot, names, q, covariance)
    clouds = None if particles is None else np.asarray(jax.vmap(place)(particles))
    bodies, other = _bodies(robot, q), None if beside is None else _bodies(robot, beside)
    with replacing(path, overwrite) as file:
        stream = rerun.RecordingStream("jaxest")
        memory = stream.memory_recording()
        stream.log("/", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if points is not None:
            stream.log("map", rerun.Points3D(points, radii=0.01, colors=_heights(points)), static=True)
        for i, stamp in enumerate(time):
            stream.set_time("time", duration=float(stamp))
            stream.log("robot", rerun.LineStrips3D(_lines(robot, bodies[i]), colors=[INK], radii=0.008))
            stream.log("robot/frames", rerun.Points3D(tips[i], labels=list(names), colors=[INK], radii=0.012))
            if other is not None:
                stream.log("beside", rerun.LineStrips3D(_lines(robot, other[i]), colors=[RED], radii=0.006))
            if spread is not None:
                half, turned = (part[i] for part in spread)
                stream.log(
                    "known", rerun.Ellipsoids3D(centers=tips[i], half_sizes=half, quaternions=turned, colors=[GREY])
                )
            if clouds is not None:
                stream.log("particles", rerun.Points3D(clouds[i].reshape(-1, 3), radii=0.003, colors=[RED]))
        file.write(memory.drain_as_bytes())


def _bodies(robot: Robot, q: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q).position))(q))


def _lines(robot: Robot, place: NDArray[np.float64]) -> list[Any]:
    parent = robot.topology.body_parent
    return [place[[up, k]] for k, up in enumerate(parent) if up >= 0]


def _ellipsoids(
    robot: Robot, names: tuple[str, ...], q: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Half axes (T, frames, 3) m and rotations (T, frames, 4) xyzw of the frames' 95 % ellipsoids."""

    def one(q: Any, covariance: Any) -> Any:
        rows = jax.numpy.stack([kinematics.jacobian(robot, q, name)[3:] for name in names])
        return rows @ covariance @ jax.numpy.swapaxes(rows, -1, -2)

    values, vectors = np.linalg.eigh(np.asarray(jax.jit(jax.vmap(one))(q, covariance), np.float64))
    vectors = vectors * np.sign(np.linalg.det(vectors))[..., None, None]  # a rotation, not a mirror
    half = SIGMAS * np.sqrt(np.maximum(values, 0))
    return half, _xyzw(vectors)


def _xyzw(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = matrix.reshape(-1, 3, 3)
    found = np.asarray(jax.vmap(quaternion.from_matrix)(flat))
    return found[:, [1, 2, 3, 0]].reshape(*matrix.shape[:-2], 4)


def _heights(points: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours from dark to light with the height."""
    z = points[:, 2]
    share = (z - z.min(initial=0)) / max(float(np.ptp(z)) if len(z) else 0.0, 1e-9)
    return np.stack([60 + 150 * share, 90 + 120 * share, 200 - 120 * share], axis=-1).astype(np.uint8)


__all__ = ["SIGMAS", "write"]
