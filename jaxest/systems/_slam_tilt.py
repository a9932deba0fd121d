"""How each ranging sensor of a whole-body SLAM is turned from where it is believed to look, found on the way.

A turn is constant, and in two parts. What the sensors of a link have in common cannot be told from the link's own
rotation by one scan, only by many as it moves: it is part of the joint state beside the biases, and map points carry
how they move with it. What each sensor adds couples with few things: in a link's normal equations these are blocks of
three that touch the state and the link's stray motion, and nothing of each other. They are taken out block by block,
exactly, and found again from what the update made of the state. Between steps a mean and a covariance a sensor are
kept; what they share with the state and with the map is not, and is made up for by `AFRESH` and `SHARED`.

One thing no motion tells: a root that stands still and all of its sensors turned alike about the first joint's axis is
a room turned the other way, and that joint's bias with it. There the prior stays, and the covariance says so.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters.kalman.gaussian import product
from jaxest.manifolds import so3
from jaxest.systems._slam_body import Body
from jaxest.types import Array

COMMON = 0.25  # share of a turn's variance that a link's sensors have in common: about four of eight see each rotation
SHIFT = 0.3  # share of the square of a sideways error that moves a point off its plane, as walls lie about a sensor
OWN = 0.003  # rad, of a sensor's direction in one scan, by what is uneven in the little that it sees of a map
SHARED = 1.0  # scans: what was unknown of turns when the map was made counts as new that seldom
AFRESH = 5.0  # scans: what is unknown of a link's turns counts as new that seldom for where the link is
BENT = 4.0  # of the square of a sensor's turn: what a map made with turned sensors is still wrong by


class Mounts(NamedTuple):
    """How sensors are turned: of a robot with L scanned links of up to S sensors, or of one link without the first."""

    ring: Array
    """(L, 3) rad, rotation vector along the link's axes that its sensors have in common; the state's covariance holds
    its own, link after link behind the biases."""
    turn: Array
    """(L, S, 3) rad, what each sensor adds to that."""
    covariance: Array
    """(L, S, 3, 3) rad2, of what each sensor adds."""


class Turned(NamedTuple):
    """What a search for planes is told of a link whose sensors' turns are estimated."""

    link: Array
    """() int32, row of the link."""
    first: Array
    """() int32, where in the state what its sensors have in common stands."""
    covariance: Array
    """(S, 3, 3) rad2, of what each adds."""
    scans: Array
    """() how many scans tell as much as one."""


class Aims(NamedTuple):
    """What a link's rows say of its sensors' turns."""

    cross: Array
    """(D + 7, 3 S) weighted products of [state, own motion, residual] with the turns."""
    held: Array
    """(S, 3, 3) covariance of a turn if all else were known."""
    prior: Array
    """(S, 3, 3) covariance before, of a turn as this scan shows it."""
    shared: Array
    """(6, 6) covariance of the link's own motion if the state were known."""
    tie: Array
    """(D, 6) products of the state with the own motion, the turns taken out."""
    pull: Array
    """(6,) the same of the residual."""


def begin(body: Body, tilt: Array) -> tuple[Mounts, Array]:
    """Return what is believed before the first scan, and the variances (3 L,) of what links' sensors have in common.

    Args:
        body: the robot.
        tilt: () rad, standard deviation of a sensor's direction about each axis.
    """
    links, most = len(body.scanned), int(body.rays.sensors.max())
    spread = (1 - COMMON) * tilt**2 * jnp.eye(3, dtype=tilt.dtype)
    zero = jnp.zeros((links, most, 3), tilt.dtype)
    mounts = Mounts(zero[:, 0], zero, jnp.broadcast_to(spread, (links, most, 3, 3)))
    return mounts, jnp.full(3 * links, COMMON * tilt**2)


def carries(body: Body) -> int:
    """Return how many numbers a map point carries for turns: moves with each link's, its share, and a variance."""
    return 10 * len(body.scanned) + 1


def unknowns(bias: Array, mounts: Mounts | None) -> Array:
    """Return what moves map points: the biases, and what the sensors of each link have in common."""
    return bias if mounts is None else jnp.concatenate([bias, mounts.ring.reshape(-1)])


def widened(pose: Any, size: int) -> Any:
    """Let a pose be moved by a state of `size`, of which all beyond what moves it is turns of sensors."""
    spare = ((0, 0), (0, size - pose.turn.shape[1]))
    return pose._replace(turn=jnp.pad(pose.turn, spare), travel=jnp.pad(pose.travel, spare))


def swung(slope: Array, rotation: Array, points: Any, first: Array) -> Array:
    """Add to how the state moves points (n, 3, D) how what their sensors have in common does, from column `first`."""
    arm = product(points.reach[:, None] * points.ray, rotation.T)
    columns = jnp.stack([jnp.cross(rotation[:, i][None], arm) for i in range(3)], axis=2)
    return jax.lax.dynamic_update_slice(slope, columns, (0, 0, first))


def along(points: Any, v: Array, turned: Turned) -> Any:
    """Move a link's points with what their sensors have in common, along the state's tangent."""
    swing = jax.lax.dynamic_slice_in_dim(v, turned.first, 3)
    return points._replace(local=points.local + jnp.cross(swing[None], points.reach[:, None] * points.ray))


def parted(kept: Array, turned: Turned) -> tuple[Array, Array]:
    """Part what map points (n, L + 1) carry beside how they move.

    Returns:
        The share that a link's own points have in them (n,), and the variances (n,) m2 by which they are off their
        planes for what was unknown of turns when they were read.
    """
    return jax.lax.dynamic_index_in_dim(kept, turned.link, axis=1, keepdims=False), kept[:, -1]


def filed(points: Any, mounts: Mounts, at: Array) -> Array:
    """Return what the points of a link carry (n, L + 1) beside how they move."""
    here = mounts.covariance[at][points.sensor]
    aside = jnp.einsum("ni,nij,nj->n", points.ray, here, points.ray, precision="highest")
    spread = SHIFT * points.reach**2 * jnp.maximum(jnp.trace(here, axis1=1, axis2=2) - aside, 0) / 2
    mine = (jnp.arange(len(mounts.ring)) == at).astype(spread.dtype)
    return jnp.concatenate([jnp.broadcast_to(mine, (len(spread), len(mine))), spread[:, None]], axis=1)


def astray(covariance: Array, sensors: Array) -> Array:
    """Return the variance () rad2 by which the turns (S, 3, 3) of `sensors` turn a link as one scan shows it."""
    there = jnp.arange(len(covariance)) < sensors
    return AFRESH * jnp.sum(jnp.where(there, jnp.trace(covariance, axis1=1, axis2=2), 0)) / (3 * sensors**2)


def aimed(points: Any, turn: Array) -> Any:
    """Return a link's points where its sensors, turned by (S, 3), see them."""
    ray = jnp.einsum("nij,nj->ni", jax.vmap(so3.exp)(turn)[points.sensor], points.ray, precision="highest")
    return points._replace(local=points.local + points.reach[:, None] * (ray - points.ray), ray=ray)


def taken_out(
    gram: Array, table: Array, mount: Any, weight: Array, far: Any, sensor: Any, covariance: Array, scans: Array
) -> tuple[Array, Array, Array, Array]:
    """Marginalise the turns out of normal equations.

    Args:
        gram: (K, K) of the rows [state, own motion, residual].
        table: (n, K) the rows.
        mount: (n, 3) their derivatives by the turn of the sensor.
        weight: (n,).
        far: (n,) rad2, by how much the map is turned there for what was unknown when it was made.
        sensor: (n,) int32, whose row it is.
        covariance: (S, 3, 3) of the turns.
        scans: () how many scans tell as much as one.

    Returns:
        The rest of `gram`, and `cross`, `held` and `prior` as in `Aims`.
    """
    sensors = covariance.shape[0]
    mine = (sensor[:, None] == jnp.arange(sensors)[None]).astype(gram.dtype)
    wide = (mine[:, :, None] * mount[:, None, :]).reshape(len(mine), -1)
    cross = product((table * weight[:, None]).T, wide)
    square = (weight[:, None] * mount)[:, :, None] * mount[:, None, :]
    own = product(mine.T, square.reshape(-1, 9)).reshape(sensors, 3, 3)
    used = mine * (weight > 0)[:, None]
    wander = jnp.sum(used * far[:, None], axis=0) / jnp.maximum(jnp.sum(used, axis=0), 1)
    eye = jnp.eye(3, dtype=gram.dtype)
    prior = covariance + (scans * OWN**2 + SHARED * wander)[:, None, None] * eye[None]
    held = _times(prior, _inverse(eye[None] + _times(own, prior)))
    held = (held + held.transpose(0, 2, 1)) / 2
    return gram - product(_blocks(cross, held), cross.T), cross, held, prior


def learned(mounts: Mounts, aims: Aims, v: Array, covariance: Array, right: Array) -> Mounts:
    """Find a link's turns again.

    Args:
        mounts: of the link, before.
        aims: of the last search for planes.
        v: (D,) the state, from where these planes were looked for.
        covariance: (D, D) of it.
        right: () bool, whether these planes are believed; nothing is learned otherwise.

    Returns:
        Turns and their covariances.
    """
    size, sensors = len(v), len(mounts.turn)
    own = aims.cross[size : size + 6]
    slope = aims.cross[:size] - product(product(aims.tie, aims.shared), own)
    off = product(slope.T, v) + aims.cross[-1] - product(own.T, product(aims.shared, aims.pull))
    turned = -jnp.sum(aims.held * off.reshape(sensors, 1, 3), axis=2)
    parts, owns = (x.reshape(-1, sensors, 3).transpose(1, 2, 0) for x in (slope, own))
    known = _times(_times(parts, covariance[None]), parts.transpose(0, 2, 1))
    known = known + _times(_times(owns, aims.shared[None]), owns.transpose(0, 2, 1))
    after = aims.held + _times(_times(aims.held, known), aims.held)
    gain = _times(mounts.covariance, _inverse(aims.prior))
    less = _times(_times(gain, aims.prior - after), gain.transpose(0, 2, 1))
    step = jnp.sum(gain * turned[:, None], axis=2)
    left = mounts.covariance - less
    left = (left + left.transpose(0, 2, 1)) / 2
    turn = jnp.where(right, mounts.turn + step, mounts.turn)
    return mounts._replace(turn=turn, covariance=jnp.where(right, left, mounts.covariance))


def _times(a: Array, b: Array) -> Array:
    return jnp.matmul(a, b, precision=jax.lax.Precision.HIGHEST)


def _blocks(cross: Array, held: Array) -> Array:
    """Multiply (K, 3 S) by a block diagonal of (S, 3, 3)."""
    parts = cross.reshape(-1, len(held), 3)
    return jnp.sum(parts[..., None] * held[None], axis=2).reshape(cross.shape)


def _inverse(a: Array) -> Array:
    """Invert (S, 3, 3) by Cramer's rule."""
    x, y, z = (a[..., i] for i in range(3))
    rows = jnp.stack([jnp.cross(y, z), jnp.cross(z, x), jnp.cross(x, y)], axis=-2)
    return rows / jnp.sum(x * rows[:, 0], axis=-1)[:, None, None]


__all__ = [
    "Aims", "Mounts", "Turned", "aimed", "along", "astray", "begin", "carries", "filed", "learned", "parted", "swung",
    "taken_out", "unknowns", "widened",
]  # fmt: skip
