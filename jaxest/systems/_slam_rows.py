"""Points of one link against the map: planes, residuals, and their normal equations."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest import linalg
from jaxest.filters.kalman.gaussian import product, symmetric
from jaxest.manifolds import so3
from jaxest.mapping import Layout, VoxelMap
from jaxest.systems._slam_surface import goes, surface
from jaxest.systems._slam_tilt import BENT, Aims, Turned, taken_out
from jaxest.types import Array

BLUR = 0.2  # share of how a plane moves with the unknowns that is not known


class Pose(NamedTuple):
    """One link at the state's mean, and how the state moves it."""

    position: Array
    """(3,) m."""
    rotation: Array
    """(3, 3)."""
    turn: Array
    """(3, D)."""
    travel: Array
    """(3, D)."""


class Points(NamedTuple):
    """What a link sees."""

    local: Array
    """(n, 3) m, in the link; finite everywhere."""
    ray: Array
    """(n, 3), direction, in the link."""
    reach: Array
    """(n,) m, the range."""
    valid: Array
    """(n,) bool."""
    sensor: Array | None = None
    """(n,) int32, which of the link's sensors saw it, where their turns are estimated."""


class Rows(NamedTuple):
    """Point-to-plane rows, about the pose they were matched at."""

    residual: Array
    """(n,) m, along the plane's normal."""
    design: Array
    """(n, D) derivative by the state's tangent."""
    lever: Array
    """(n, 6) derivative by a small motion of the link alone, [rotation, translation] along the world's axes."""
    weight: Array
    """(n,) 1/m2; 0 where a row does not count."""
    matched: Array
    """(n,) bool, points with enough of the map about them, whether it makes a plane that they lie on or not."""
    misfit: Array
    """() how badly the points fit in all: squared residuals in units of the gate, 1 for each that does not fit."""
    odd: Array
    """() sum of the squared residuals that count, in the variance that readings and planes alone give them."""
    mount: Array | None = None
    """(n, 3) derivative by the turn of the sensor, along the link's axes."""
    far: Array | None = None
    """(n,) rad2, by how much the map is turned there for what was unknown of sensors when it was made."""


class Sums(NamedTuple):
    """Normal equations of a link's rows, its own unknown motion taken out."""

    information: Array
    """(D, D)."""
    pull: Array
    """(D,), of minus the residuals."""
    pose: Array
    """(6, 6) H' R^-1 H of the link's own pose, [rotation, translation]."""
    inliers: Array
    """() int32, rows that count."""
    matched: Array
    """() int32, points with enough of the map about them."""
    seen: Array
    """() int32, points there were."""
    aims: Aims | None = None
    """What the rows say of the sensors' turns."""


def moved(pose: Pose, v: Array) -> Pose:
    """Move a link along the state's tangent, its derivatives kept."""
    turned = product(so3.exp(product(pose.turn, v)), pose.rotation)
    return pose._replace(position=pose.position + product(pose.travel, v), rotation=turned)


def world(pose: Pose, local: Array) -> Array:
    """Return points (n, 3) m in the world."""
    return product(local, pose.rotation.T) + pose.position[None]


def point_slope(pose: Pose, x: Array) -> Array:
    """Return the derivative (n, 3, D) of world points (n, 3) on a link by the state's tangent."""
    arm, (u, v, w) = x - pose.position[None], pose.turn
    none = jnp.zeros_like(u)
    # Affine in the point, so one product of matrices; put together row by row, each number would choose among three.
    parts = jnp.stack([none, w, -v, -w, none, u, v, -u, none, *pose.travel]).reshape(4, -1)
    one = jnp.ones((len(x), 1), x.dtype)
    return product(jnp.concatenate([arm, one], axis=1), parts).reshape(len(x), 3, len(u))


def match(
    layout: Layout, chart: VoxelMap, params: Any, pose: Pose, points: Points, offset: Array, covariance: Array,
    slack: Array | None = None, turned: Turned | None = None,
) -> Rows:  # fmt: skip
    """Find a plane beside each point, and write the distance to it as a row.

    Args:
        layout: the map's.
        chart: the map; its points carry how they move with the biases, (3 * biases,).
        params: the system's.
        pose: where the link is taken to be.
        points: what it sees.
        offset: (n,) the biases' mean less that at which the map's points stand.
        covariance: (D, D) of the state, of which the last n are the biases.
        slack: (6,) variances of a free root's position and rotation, which the gate lets residuals have besides; None
            where the root is fixed.
        turned: where the sensors' turns are estimated.

    Returns:
        The rows.
    """
    x = world(pose, points.local)
    scatter = params.noise * points.reach
    ray = product(points.ray, pose.rotation.T)
    plane = surface(layout, chart, x, scatter[:, None] * ray, scatter, params.uneven, len(offset), turned)
    planes, read, hazy, n = plane.planes, plane.read, plane.hazy, plane.planes.normal
    known = points.valid & planes.valid
    roots = len(covariance) - len(offset)
    moves, unsure = goes(plane, x), covariance[roots:, roots:]
    sway = jnp.sum(product(moves, unsure) * moves, axis=1)
    # Of links whose biases are not known yet a wall has layers.
    found = known & (planes.thickness < params.thickness + scatter + (hazy + sway) ** 0.5)
    residual = jnp.sum(n * (x - planes.center), axis=1) - product(moves, offset)
    slant = jnp.sum(n * ray, axis=1)
    white = (scatter * slant) ** 2
    bent = 0 if turned is None else BENT * params.tilt**2 * points.reach
    lasting = params.lasting**2 + (params.share * scatter**2) ** 2 + bent**2
    tilted = (params.tilt * points.reach) ** 2 * jnp.maximum(1 - slant**2, 0) if turned is None else hazy
    plain = white * (1 + 1 / jnp.maximum(read, 1)) + lasting + tilted + params.uneven**2
    over = jnp.where(found, _overshoot(residual, slant, scatter, plain), 0)
    x, reach = x - over[:, None] * ray, points.reach - over
    arm, along = x - pose.position[None], goes(plane, x)
    lever = jnp.concatenate([jnp.cross(arm, n), n], axis=1)
    design = product(lever, jnp.concatenate([pose.turn, pose.travel]))
    mount: Any = None
    if turned is not None:
        swing = jnp.cross(reach[:, None] * points.ray, product(n, pose.rotation))
        design = jax.lax.dynamic_update_slice(design, swing, (0, turned.first))
        # With what the sensors of a link have put into the map themselves they agree, however they are turned.
        mount = (1 - plane.own)[:, None] * swing
    whole = design[:, roots:]
    design = design.at[:, roots:].add(-along)
    allowed = _allowed(params, points, design, mount, hazy, slack, turned)
    shares = residual**2 / allowed
    inside = found & (shares < 1)
    again = _alike(whole, along, unsure) * read
    variance = _variance(params, planes.thickness, scatter, white, tilted, read, again * (lasting + BLUR**2 * sway))
    odd = jnp.sum(jnp.where(inside, residual**2 / plain, 0))
    misfit = jnp.sum(jnp.where(points.valid, jnp.where(inside, shares, 1), 0))
    far = None if turned is None else hazy / points.reach**2
    return Rows(residual, design, lever, jnp.where(inside, 1 / variance, 0), known, misfit, odd, mount, far)


def _allowed(
    params: Any, points: Points, design: Array, mount: Any, hazy: Any, slack: Array | None, turned: Turned | None
) -> Array:
    """Return the squares (n,) m2 of the residuals beyond which rows do not count."""
    allowed = params.gate**2 * points.reach + 9 * (params.noise * points.reach) ** 2
    if slack is not None:
        allowed = allowed + 9 * product(design[:, :6] ** 2, slack)
    if turned is not None:
        allowed = allowed + 9 * (hazy + jnp.einsum("ni,nij,nj->n", mount, turned.covariance[points.sensor], mount))
    return allowed


def _variance(
    params: Any, thickness: Array, scatter: Array, white: Array, tilted: Array, read: Array, shared: Array
) -> Array:
    """Return the variances (n,) m2 of residuals, of planes `read` times on average that share errors of `shared`.

    Planes of a few readings each are wrong alike for all that is compared with them, and for scans to come.
    """
    once = 1 / jnp.maximum(read, 1)
    variance = (params.floor**2 + white + thickness**2) * (1 + params.fresh * once) + tilted
    variance = variance + params.rough * scatter**2 * once
    return (variance + shared) ** 2 / variance


def _overshoot(residual: Array, slant: Array, scatter: Array, variance: Array) -> Array:
    """Return how much too long (n,) m a range is likely to be, for a residual of a variance (n,) m2 that has it in it.

    A point that its range's error e puts too far off has a lever too long by e, and a residual of e times the slant.
    Their product is e^2 on average, not 0, and in scan after scan it would turn the link the same way. What a residual
    tells of e is taken off the lever; the rest is independent of the residual.
    """
    return scatter**2 * slant * residual / variance


def _alike(whole: Array, along: Array, covariance: Array) -> Array:
    """Return how far (n,) planes move with what is unknown of the biases as their points do, 0 to 1.

    So much of a plane was read by what is compared with it now, or by what hangs on the same joints: it was compared
    before, with the same errors that no reading takes away. If N readings of scatter s share an error e, they tell
    N / (s^2 + N e^2), and the N-th of them so little more than those before that it counts as of (s^2 + N e^2)^2 / s^2.
    """
    spread = product(whole, covariance)
    total = jnp.sum(spread * whole, axis=1)
    return jnp.clip(jnp.sum(spread * along, axis=1) / jnp.where(total > 0, total, 1), 0, 1)


def sums(rows: Rows, points: Points, spare: Array, turned: Turned | None = None) -> Sums:
    """Sum rows up; what the link may have moved on its own, with covariance `spare` (6, 6), is marginalised out.

    Residuals of one scan share the errors of their planes and of the link, so that however many they are, they do not
    place it better than `spare`.
    """
    dimension = rows.design.shape[1]
    table = jnp.concatenate([rows.design, rows.lever, rows.residual[:, None]], axis=1)
    gram = product((table * rows.weight[:, None]).T, table)
    state, own = slice(0, dimension), slice(dimension, dimension + 6)
    if turned is not None:
        gram, through, apart, before = taken_out(
            gram, table, rows.mount, rows.weight, rows.far, points.sensor, turned.covariance, turned.scans
        )
    pose = gram[own, own]
    shared = linalg.solve(jnp.eye(6, dtype=gram.dtype) + product(spare, pose), spare)
    cross = gram[state, own]
    held = product(cross, shared)
    information = symmetric(gram[state, state] - product(held, cross.T))
    pull = -(gram[state, -1] - product(held, gram[own, -1]))
    used = rows.weight > 0
    inliers, matched, seen = (jnp.sum(m, dtype=jnp.int32) for m in (used, rows.matched, points.valid))
    aims = None if turned is None else Aims(through, apart, before, shared, cross, gram[own, -1])
    return Sums(information, pull, pose, inliers, matched, seen, aims)


__all__ = ["Points", "Pose", "Rows", "Sums", "match", "moved", "point_slope", "sums", "world"]
