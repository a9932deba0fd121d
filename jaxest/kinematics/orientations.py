"""Joint coordinates from orientations: least squares on the manifold, with the covariance that the data leave."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import linalg
from jaxest.kinematics.coordinates import Links
from jaxest.kinematics.fold import carriers, fold
from jaxest.kinematics.forward import configuration, links, place_frames, selection
from jaxest.kinematics.jacobian import velocity_axes
from jaxest.kinematics.movement import coupled, moved, movers, spread
from jaxest.kinematics.plan import Plan, plan
from jaxest.kinematics.poses import joint_poses
from jaxest.kinematics.robot import Robot
from jaxest.manifolds import quaternion as quat
from jaxest.types import NON_FINITE, NOT_CONVERGED, OK, Array, ArrayLike

UNKNOWN = np.pi**2 / 3
"""Variance of an angle of which nothing is known, rad^2."""
REACH = 1.0  # rad, the longest move of a coordinate in one step


class Observed(NamedTuple):
    """Orientations of m frames, each in the world or in another frame."""

    quaternion: ArrayLike
    """(m, 4) wxyz, frame to reference."""
    information: ArrayLike
    """(m, 3, 3) 1/rad^2 of the error theta in `truth = exp(theta) quaternion`, along the reference's axes; a direction
    about which nothing is known has 0, as the world's z for an IMU without a heading."""


class Fit(NamedTuple):
    """Joint coordinates and how well they are known."""

    q: Array
    """(nq,)"""
    covariance: Array
    """(nv, nv) of the error in velocity coordinates, the prior included."""
    known: Array
    """(nv,) share of each coordinate's variance that the orientations took away; far below 1 is not observed."""
    residual: Array
    """(m, 3) rad, what is left of each orientation, along the reference's axes."""
    status: Array
    """() int32, `OK`, `NOT_CONVERGED` or `NON_FINITE` (q is then where it started)."""


def rotations(
    robot: Robot, q: ArrayLike, frames: Sequence[int | str], references: Sequence[int | str | None] | None = None
) -> tuple[Array, Array]:
    """Compute frames' orientations and how they turn with the joints.

    Args:
        robot: the robot.
        q: (nq,) joint coordinates; batch with `jax.vmap`.
        frames: static, m frames by index or name.
        references: static, the frame that each is seen from; None for the world, and for all.

    Returns:
        Quaternions (m, 4) wxyz, frame to reference, and Jacobians (m, 3, nv) from velocities to the frame's angular
        velocity against the reference, along the reference's axes.

    Raises:
        ValueError: q has the wrong shape, an index is out of range, or there are not as many references as frames.
        InputError: a frame's name does not exist.
    """
    seen = [None] * len(frames) if references is None else list(references)
    if len(seen) != len(frames):
        raise ValueError(f"references: got {len(seen)}, expected one for each of {len(frames)} frames")
    q = configuration(robot, q)
    folded = fold(robot)
    named = [f for f in seen if f is not None]
    chosen = selection(robot, (*frames, *named))
    planned = plan(robot, chosen, folded).whole()
    offsets = jnp.asarray(folded.frame_translation, q.dtype), jnp.asarray(folded.frame_quaternion, q.dtype)
    other = iter(range(len(frames), len(chosen)))
    behind = tuple(-1 if f is None else next(other) for f in seen)
    return _rotations(planned, _above(robot, chosen), behind, robot.nv, links(robot, folded, q.dtype), offsets, q)


def _above(robot: Robot, frames: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Return the joints that carry each frame."""
    carried = carriers(robot.topology)
    found = []
    for frame in frames:
        joint, chain = carried.frame[frame], []
        while joint >= 0:
            chain.append(joint)
            joint = carried.joint[joint]
        found.append(tuple(chain))
    return tuple(found)


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _rotations(
    planned: Plan,
    above: tuple[tuple[int, ...], ...],
    behind: tuple[int, ...],
    nv: int,
    constants: Links,
    offsets: tuple[Array, Array],
    q: Array,
) -> tuple[Array, Array]:
    poses = joint_poses(planned, constants, q) if planned.order.joint else None
    count = len(behind)
    if poses is None:  # nothing moves
        quaternions = offsets[1][np.array(planned.frames)]
        slopes = jnp.zeros((len(above), 3, nv), q.dtype)
    else:
        quaternions = jnp.stack(place_frames(planned, poses, offsets)[1], -1)
        axes = velocity_axes(planned.order, constants, poses)
        rates = jnp.zeros((3, nv), q.dtype).at[:, np.array(axes.velocity)].set(jnp.stack(axes.rotation))
        joints = [planned.order.joint[s] for s in axes.step]
        mask = np.zeros((len(above), 1, nv), bool)
        for row, chain in enumerate(above):
            mask[row, 0, [v for v, j in zip(axes.velocity, joints, strict=True) if j in chain]] = True
        slopes = jnp.where(mask, rates[None], 0)
    identity, still = quat.identity(q.dtype)[None], jnp.zeros((1, 3, nv), q.dtype)
    at = np.array([len(above) if b < 0 else b for b in behind])
    base, base_slope = jnp.concatenate([quaternions, identity])[at], jnp.concatenate([slopes, still])[at]

    def seen(base: Array, rotation: Array, slope: Array) -> tuple[Array, Array]:
        back = quat.inverse(base)
        return quat.compose(back, rotation), quat.to_matrix(back) @ slope

    found: tuple[Array, Array] = jax.vmap(seen)(base, quaternions[:count], slopes[:count] - base_slope)
    return found


def errors(
    robot: Robot, q: Array, frames: Sequence[int | str], references: Any, observed: Array
) -> tuple[Array, Array]:
    """Compute how far observed orientations are from the model's, and how that shrinks with the joints' velocities.

    Args:
        robot: the robot.
        q: (nq,).
        frames: static, m frames.
        references: static, as in `rotations`.
        observed: (m, 4) wxyz.

    Returns:
        Rotation vectors (m, 3), rad along the references' axes, and slopes (m, 3, nv).
    """
    model, slopes = rotations(robot, q, frames, references)

    def one(observed: Array, model: Array, slope: Array) -> tuple[Array, Array]:
        error = quat.log(quat.compose(observed, quat.inverse(model)))
        return error, quat.right_jacobian_inverse(error) @ slope

    found: tuple[Array, Array] = jax.vmap(one)(observed, model, slopes)
    return found


def fit_orientations(
    robot: Robot,
    frames: Sequence[int | str],
    observed: Observed,
    q0: ArrayLike,
    *,
    references: Sequence[int | str | None] | None = None,
    prior: ArrayLike = UNKNOWN,
    iterations: int = 12,
) -> Fit:
    """Find the joint coordinates that explain orientations best, by least squares on the robot's manifold.

    Hinges, several of them on a link, balls and free joints in any tree; coupled joints follow their leaders. What the
    orientations do not tell (slides, headings without a magnetometer) stays at q0 with the variance of the prior. One
    configuration; batch it with `jax.vmap`.

    Args:
        robot: the robot.
        frames: static, the m frames that are observed, by index or name.
        observed: their orientations and the information of these.
        q0: (nq,) start, and centre of the prior.
        references: static, the frame that each is seen from; None for the world, and for all.
        prior: () variance of every coordinate about q0, rad^2 or m^2; half a turn either way by default.
        iterations: static, Gauss-Newton steps.

    Returns:
        The fit.

    Raises:
        ValueError: a shape is wrong.
        InputError: a frame's name does not exist.
    """
    start = configuration(robot, q0)
    dtype, m = start.dtype, len(frames)
    seen, weight = (jnp.asarray(x, dtype) for x in observed)
    if seen.shape != (m, 4) or weight.shape != (m, 3, 3):
        raise ValueError(f"observed: shapes {seen.shape} and {weight.shape}, expected ({m}, 4) and ({m}, 3, 3)")
    sound = jnp.all(jnp.isfinite(seen)) & jnp.all(jnp.isfinite(weight)) & jnp.all(jnp.isfinite(start))
    start = jnp.where(sound, start, jnp.asarray(robot.home, dtype))
    seen = jnp.where(sound, seen, jnp.zeros_like(seen).at[:, 0].set(1))
    weight = jnp.where(sound, weight, 0)
    names = tuple(
        robot.frame_names[i] for i in selection(robot, [*frames, *[f for f in references or () if f is not None]])
    )
    moving = movers(robot.topology, names)
    scale = 1 / jnp.asarray(prior, dtype)

    def step(carry: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], Array]:
        q, gone = carry
        error, slope = errors(robot, q, frames, references, seen)
        design = slope @ spread(robot, moving, q)
        hessian = _sum(design, weight, design) + scale * jnp.eye(design.shape[2], dtype=dtype)
        pull = _sum(design, weight, error[:, :, None])[:, 0] - scale * gone
        move = jnp.clip(_solve(hessian, pull[:, None])[:, 0], -REACH, REACH)
        q = coupled(robot, moved(robot, q, spread(robot, moving, q) @ move))
        return (q, gone + move), jnp.max(jnp.abs(move), initial=0)

    nothing = jnp.zeros(spread(robot, moving, start).shape[1], dtype)
    (q, _), moves = jax.lax.scan(step, (start, nothing), None, length=iterations)
    error, slope = errors(robot, q, frames, references, seen)
    across = spread(robot, moving, q)
    hessian = _sum(slope @ across, weight, slope @ across) + scale * jnp.eye(across.shape[1], dtype=dtype)
    inner = _solve(hessian, across.T)
    untouched = jnp.diag(jnp.where(jnp.any(across != 0, axis=1), 0, 1 / scale))
    covariance = across @ inner + untouched
    before = jnp.sum(across * across, axis=1) / scale
    known = jnp.where(before > 0, 1 - jnp.diagonal(covariance) / jnp.where(before > 0, before, 1), 0)
    settled = moves[-1] < 100 * jnp.sqrt(jnp.finfo(dtype).eps)
    status = jnp.where(sound, jnp.where(settled, OK, NOT_CONVERGED), NON_FINITE).astype(jnp.int32)
    return Fit(q, (covariance + covariance.T) / 2, known, error, status)


def _sum(a: Array, weight: Array, b: Array) -> Array:
    """Sum a_i' W_i b_i over the observations, (n, k), in full precision."""
    half = jnp.einsum("mij,mjk->mik", weight, b, precision=jax.lax.Precision.HIGHEST)
    return jnp.einsum("mij,mik->jk", a, half, precision=jax.lax.Precision.HIGHEST)


def _solve(hessian: Array, right: Array) -> Array:
    """Solve, scaled to a unit diagonal so that well and badly known coordinates keep their digits in float32."""
    scale = 1 / jnp.sqrt(jnp.diagonal(hessian))
    factor = linalg.cholesky(hessian * scale[:, None] * scale[None, :])
    return scale[:, None] * linalg.cho_solve(factor, scale[:, None] * right)


__all__ = ["UNKNOWN", "Fit", "Observed", "errors", "fit_orientations", "rotations"]
