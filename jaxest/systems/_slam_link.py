"""Link by link through the body: match, update, bring the points into the map."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.kalman import information_gain
from jaxest.filters.kalman.factors import reanchor
from jaxest.filters.kalman.gaussian import product, sandwich, symmetric
from jaxest.mapping import Layout, VoxelMap, carried, insert, likeliest, shift
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body, Mean
from jaxest.systems._slam_rows import Points, Pose, Sums, match, moved, point_slope, sums, world
from jaxest.types import Array

TRIALS = np.linspace(-2.5, 2.5, 21)  # deviations of a bias at which a link is tried
DOUBT = 0.05  # rad or m: a bias known worse is tried
ALIKE = 1e-4  # share by which one start must fit better than another
STEP = 5e-3  # m or rad: planes are looked for again when a link has moved by more
BEND = 1e-3  # rad or m: the map is bent at once when a bias has changed by more, and at the end of the step anyway
LASTS = 25.0  # scans: an error of the link's that never changes counts as new that seldom
STILL = 500  # scans of a link that stands still tell as much as two
REACH = 1.0  # m, at which a rotation counts as a motion


class Config(NamedTuple):
    """Sizes and choices, static."""

    layout: Layout
    points: int
    """Zones of a link that take part in an update; others follow at the next steps."""
    rounds: int
    """Searches for planes in an update at most."""
    least: int
    """Inliers without which a link keeps its prediction."""
    central: bool
    """Whether voxels keep the point nearest to their centre."""


class Carry(NamedTuple):
    """What goes from link to link."""

    mean: Mean
    covariance: Array
    chart: VoxelMap
    reference: Array
    """(n,) biases at which the map's points stand."""
    links: bodies.Links
    """Of the scanned links, at the mean."""


class Seen(NamedTuple):
    """What a link made of its points; leaves get a leading axis of L."""

    sums: Sums
    odd: Array
    """() as `Rows.odd`, where planes were looked for last."""
    surprise: Array
    """() squared length of the correction in the prediction's deviations, by the dimensions a link has."""
    rounds: Array
    """() int32, searches for planes."""
    settled: Array
    """() bool."""
    kept: Array
    """() bool, points went into the map."""


def walk(
    body: Body, config: Config, params: Any, start: Carry, reading: Array, noise: Array, points: Points, scans: Array,
    index: Array,
) -> tuple[Carry, Seen]:  # fmt: skip
    """Update with each scanned link's points in turn, parents first.

    Args:
        body: the robot.
        config: sizes.
        params: the system's.
        start: belief and map.
        reading: (n,) encoders.
        noise: (n,) variance of each joint's reading, rad2 or m2, new at each step.
        points: of all links, (L, Z, ...).
        scans: (L,) how many of a link's scans tell as much as one, as `repeats` says.
        index: () int32, steps seen: it tells which zones' turn it is.

    Returns:
        Belief and map after the last link, and what each saw.
    """
    roots = body.size - len(body.joints)
    parts = max(1, points.valid.shape[1] // config.points)
    turn = jnp.mod(index, parts)

    def link(carry: Carry, row: tuple[Array, Points, Array, Array]) -> tuple[Carry, Seen]:
        at, mine, count, alike = row
        here = _pose(carry.links, at)
        slope = jnp.concatenate([here.turn, here.travel])[:, roots:]
        spare = product(slope * noise[None], slope.T) + jnp.diag(_stray(params, mine, count, alike))
        carry, seen = _register(body, config, params, carry, here, mine, spare, parts, turn)
        carry = carry._replace(links=bodies.links(body, carry.mean, reading, body.scanned))
        return _learn(config, params, carry, _pose(carry.links, at), mine, seen, roots)

    sensors = jnp.asarray(body.rays.sensors, start.covariance.dtype)
    return jax.lax.scan(link, start, (jnp.arange(len(body.scanned)), points, sensors, scans))


def repeats(params: Any, links: bodies.Links, before: bodies.Links, index: Array) -> Array:
    """Say how many scans of each link (L,) tell as much about where it is as one whose errors are its own.

    From one place the map is wrong by the same in each scan: a link that goes a fraction of `renewal` in a step needs
    as many steps until its errors are others. At the first step it has seen none before.

    Args:
        params: the system's.
        links: the scanned links.
        before: the same at the step before.
        index: () int32, steps seen.
    """
    turned = jnp.sum(links.rotation * before.rotation, axis=(1, 2))
    gone = jnp.linalg.norm(links.position - before.position, axis=1) + REACH * jnp.sqrt(jnp.maximum(3 - turned, 0))
    return jnp.where(index == 0, 1, 1 + 2 * params.renewal / (gone + params.renewal / STILL))


def _stray(params: Any, points: Points, sensors: Array, scans: Array) -> Array:
    """Return the variances (6,) of a link's rotation and position that one scan leaves, however many its points."""
    share = params.stray * params.noise
    count = jnp.maximum(jnp.sum(points.valid), 1)
    far = jnp.sum(jnp.where(points.valid, points.reach**2, 0)) / count
    # Sensors that point elsewhere do so in every scan.
    rotation = scans * (params.stray_rotation**2 + share**2) + LASTS * params.tilt**2 / sensors
    position = scans * (params.stray_position**2 + share**2 * far)
    return jnp.concatenate([jnp.full(3, rotation), jnp.full(3, position)])


def subset(x: Array, parts: int, turn: Array) -> Array:
    """Take each `parts`-th zone, beginning with `turn`."""
    whole = x.shape[0] - x.shape[0] % parts
    grouped = x[:whole].reshape(whole // parts, parts, *x.shape[1:])
    return jax.lax.dynamic_index_in_dim(grouped, turn, axis=1, keepdims=False)


def _pose(links: bodies.Links, at: Array) -> Pose:
    return Pose(*(jax.lax.dynamic_index_in_dim(x, at, keepdims=False) for x in links))


class Fit(NamedTuple):
    """One search for planes, and what the update made of it."""

    correction: Array
    """(D,) from the prediction."""
    covariance: Array
    sums: Sums
    odd: Array
    surprise: Array
    misfit: Array
    """() of the points where they were looked for."""


def _register(
    body: Body, config: Config, params: Any, carry: Carry, pose: Pose, points: Points, spare: Array,
    parts: int, turn: Array,
) -> tuple[Carry, Seen]:  # fmt: skip
    """Iterate plane search and update until the link stays where it is, from the best of several starts at first.

    A joint of unknown bias is tried at biases over its whole prior, with all zones: from the middle of it planes two
    metres off are missed by more than lies between one and the next, and the update ends in the wrong one.
    """
    mean, covariance = carry.mean, carry.covariance
    roots = body.size - len(body.joints)

    def once(v: Array, turn: Array) -> Fit:
        some = jax.tree.map(lambda x: subset(x, parts, turn), points)
        offset = mean.bias + v[roots:] - carry.reference
        rows = match(config.layout, carry.chart, params, moved(pose, v), some, offset, covariance)
        found = sums(rows, some, spare)
        enough = found.inliers >= config.least
        information = jnp.where(enough, found.information, 0)
        pull = jnp.where(enough, found.pull, 0)
        gained = information_gain(covariance, information, pull + product(information, v))
        surprise = jnp.sum(gained.correction * gained.dual) / min(6, body.size)
        return Fit(gained.correction, gained.covariance, found, rows.odd, surprise, rows.misfit)

    def size(v: Array) -> Array:
        v = jax.lax.stop_gradient(v)
        turned, travelled = product(pose.turn, v), product(pose.travel, v)
        return jnp.max(jnp.abs(travelled)) + REACH * jnp.max(jnp.abs(turned))

    direction, unknown = _doubt(covariance, pose, roots)

    def again(state: Any, row: tuple[Array, Array, Array]) -> tuple[Any, None]:
        fit, last, (least, best, total), count = state
        offset, part, trial = row
        start = jnp.where(trial, offset * direction, jnp.where(count == 0, best, fit.correction))
        needed = jnp.where(trial, unknown, (count == 0) | (size(fit.correction - last) > STEP))
        new = jax.lax.cond(needed, lambda: once(start, jnp.where(trial, part, turn)), lambda: fit)
        total = jnp.where(part == 0, 0, total) + new.misfit
        # Of starts that fit alike the first counts: what is left of a sum's rounding must not choose.
        better = trial & needed & (part == parts - 1) & (total < (1 - ALIKE) * least)
        found = (jnp.where(better, total, least), jnp.where(better, start, best), total)
        worked = needed & ~trial
        return (new, jnp.where(worked, start, last), found, count + worked.astype(jnp.int32)), None

    # Trials and iterations are one scan, so that their program is there once.
    zero, none = jnp.zeros(body.size, covariance.dtype), jnp.int32(0)
    nothing = Sums(jnp.zeros_like(covariance), zero, jnp.zeros_like(spare), none, none, none)
    first = (Fit(zero, covariance, nothing, zero[0], zero[0], zero[0]), zero, (zero[0] + jnp.inf, zero, zero[0]), none)
    offsets = jnp.asarray(np.concatenate([np.repeat(TRIALS, parts), np.zeros(config.rounds)]), zero.dtype)
    trial = np.arange(len(offsets)) < len(TRIALS) * parts
    rows = (offsets, jnp.asarray(np.arange(len(offsets)) % parts), jnp.asarray(trial))
    (fit, last, _, count), _ = jax.lax.scan(again, first, rows)
    v, after = fit.correction, fit.covariance
    if body.root is not None:
        frame = reanchor(bodies.manifold(body), mean, v, bodies.retract(body, mean, v))
        after = symmetric(sandwich(frame, after))
    settled = size(v - last) <= 4 * STEP
    done = rebased(carry._replace(mean=bodies.retract(body, mean, v), covariance=after))
    return done, Seen(fit.sums, fit.odd, fit.surprise, count, settled, jnp.bool_(True))


def _doubt(covariance: Array, pose: Pose, roots: int) -> tuple[Array, Array]:
    """Return how the state moves (D,) with the least known bias that moves a link, per deviation; is that much?"""
    moves = jnp.sum(pose.turn**2 + pose.travel**2, axis=0) > 0
    bias = jnp.arange(len(moves)) >= roots
    variance = jnp.where(moves & bias, jnp.diagonal(covariance), 0)
    column = jax.lax.dynamic_index_in_dim(covariance, jnp.argmax(variance), axis=1, keepdims=False)
    deviation = jnp.sqrt(jnp.where(jnp.max(variance) > 0, jnp.max(variance), 1))
    return jax.lax.stop_gradient(column / deviation), jnp.max(variance) > DOUBT**2


def _learn(
    config: Config, params: Any, carry: Carry, pose: Pose, points: Points, seen: Seen, roots: int
) -> tuple[Carry, Seen]:
    """Bring a link's points into the map, if the link is known well enough."""
    x = world(pose, points.local)
    slope = point_slope(pose, x)[:, :, roots:]
    x = x - product(slope, carry.mean.bias - carry.reference)
    where = product(pose.travel, product(carry.covariance, pose.travel.T))
    kept = jnp.trace(where) < params.admit**2
    ray, scatter = product(points.ray, pose.rotation.T), params.noise * points.reach
    filed = None if config.central else likeliest(config.layout, carry.chart, x, ray, scatter)
    chart = insert(
        config.layout, carry.chart, x, points.valid & kept, slope.reshape(len(x), -1), filed=filed,
        central=config.central,
    )  # fmt: skip
    return carry._replace(chart=chart), seen._replace(kept=kept)


def rebased(carry: Carry, least: float = BEND) -> Carry:
    """Move the map's points to where the biases now put them, if those changed by `least` rad or m or more."""

    def bend() -> tuple[VoxelMap, Array]:
        slope = carried(carry.chart).reshape(carry.chart.point.shape[0], 3, -1)
        return shift(carry.chart, product(slope, carry.mean.bias - carry.reference)), carry.mean.bias

    far = jnp.max(jnp.abs(carry.mean.bias - carry.reference), initial=0) >= least
    chart, reference = jax.lax.cond(far, bend, lambda: (carry.chart, carry.reference))
    return carry._replace(chart=chart, reference=reference)


__all__ = ["Carry", "Config", "Seen", "rebased", "repeats", "subset", "walk"]
