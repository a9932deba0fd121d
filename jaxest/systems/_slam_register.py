"""One link against the map: where its points say it is."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters.kalman import information_gain
from jaxest.filters.kalman.factors import reanchor
from jaxest.filters.kalman.gaussian import product, sandwich, symmetric
from jaxest.mapping import Layout, VoxelMap
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_bend import bent
from jaxest.systems._slam_body import Body, Mean
from jaxest.systems._slam_rows import Points, Pose, Sums, match, moved, sums
from jaxest.systems._slam_tilt import Mounts, Turned, along, unknowns
from jaxest.types import Array

TRIALS = np.linspace(-2.5, 2.5, 21)  # deviations of a bias at which a link is tried
DOUBT = 0.05  # rad or m: a bias known worse is tried
ALIKE = 1e-4  # share by which one start must fit better than another
POINTS = 0.5  # by so many points that do not fit as well
STEP = 5e-3  # m or rad: planes are looked for again when a link has moved by more
BEND = 1e-3  # rad or m: the map is bent when what its points were placed by has changed by more
REACH = 1.0  # m, at which a rotation counts as a motion
FITS = 0.3  # share of the points with the map about them that must lie on its planes
ASTRAY = 0.7  # of the usual share: a free root of which less fits is looked for
FOUND = 0.8  # of the usual share must fit where it is found
AMISS = 0.5  # of the usual share: less is lost
BETTER = 0.7  # of the prediction's misfit must be left at another place that counts
MANY = 3  # as many points as an update needs say that
TURNS = np.concatenate([np.zeros((1, 3)), *(s * np.eye(3) for s in (0.25, -0.25, 0.5, -0.5, 1.0, -1.0))])
WIDTHS = (0.2, 0.06, 0.0)  # by the way that is searched, how far off points may be, coarse to fine


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
    """(n,) unknowns at which the map's points stand."""
    links: bodies.Links
    """Of the scanned links, at the mean."""
    mounts: Mounts | None = None
    """Of all sensors, where their turns are estimated."""


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
    lost: Array
    """() bool, a free root that is not where it was looked for, or hangs on one."""


def subset(x: Array, parts: int, turn: Array) -> Array:
    """Take each `parts`-th zone, beginning with `turn`."""
    whole = x.shape[0] - x.shape[0] % parts
    grouped = x[:whole].reshape(whole // parts, parts, *x.shape[1:])
    return jax.lax.dynamic_index_in_dim(grouped, jnp.mod(turn, parts), axis=1, keepdims=False)


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


def _once(
    body: Body, config: Config, params: Any, carry: Carry, pose: Pose, points: Points, spare: Array, parts: int,
    turned: Turned | None, prior: Array, v: Array, turn: Array, slack: Array | None,
) -> Fit:  # fmt: skip
    """Look for planes with the state moved by v (D,), and update a prior covariance (D, D) with them."""
    some = jax.tree.map(lambda x: subset(x, parts, turn), points)
    some = some if turned is None else along(some, v, turned)
    offset = unknowns(carry.mean.bias, carry.mounts) + v[body.size - len(body.joints) :] - carry.reference
    rows = match(config.layout, carry.chart, params, moved(pose, v), some, offset, prior, slack, turned)
    found = sums(rows, some, spare, turned)
    enough = found.inliers >= config.least
    information = jnp.where(enough, found.information, 0)
    pull = jnp.where(enough, found.pull, 0)
    gained = information_gain(prior, information, pull + product(information, v))
    surprise = jnp.sum(gained.correction * gained.dual) / min(6, body.size)
    return Fit(gained.correction, gained.covariance, found, rows.odd, surprise, rows.misfit)


def amiss(config: Config, found: Sums, share: float = FITS) -> Array:
    """Say whether too few points lie on the map that is about them: more than an update needs, and not on its planes.

    Args:
        config: sizes.
        found: of a link, or of all with a leading axis.
        share: of the points with the map about them that must lie on it.

    Returns:
        () or (L,) bool.
    """
    return (found.inliers < share * found.matched) & (found.matched >= MANY * config.least)


def _found_again(
    config: Config, params: Any, carry: Carry, fit: Fit, last: Array, leads: Array, usual: Array, once: Any,
    turn: Array,
) -> tuple[Fit, Array, Array]:  # fmt: skip
    """Look for a free root that is not where it was predicted: from rotations about each axis, coarse gates first.

    What still fits badly changes nothing, and leaves a root that may be anywhere that was searched; the map then takes
    no points.
    """
    wide = jnp.concatenate([jnp.full(3, params.search / 4), jnp.full(3, params.search)]) ** 2
    unknown = jnp.maximum(wide - jnp.diagonal(carry.covariance)[:6], 0)
    prior = carry.covariance.at[np.arange(6), np.arange(6)].add(unknown)
    size = len(carry.covariance)
    starts = np.zeros((len(TURNS), size))
    starts[:, 3:6] = TURNS

    def again(state: tuple[Fit, Fit, Array], row: tuple[Array, Array, Array]) -> tuple[tuple[Fit, Fit, Array], None]:
        fit, best, last = state
        start, width, phase = row
        v = jnp.where(phase == 0, start * params.search, fit.correction)
        v = jnp.where(phase == len(WIDTHS), best.correction, v)
        new = once(prior, v, turn, width**2 * wide)
        better = (phase == len(WIDTHS)) | ((phase == len(WIDTHS) - 1) & (new.misfit < (1 - ALIKE) * best.misfit))
        best = jax.tree.map(lambda a, b: jnp.where(better, a, b), new, best)
        return (new, best, jnp.where(better, v, last)), None

    def search() -> tuple[Fit, Array]:
        vectors = np.concatenate([np.repeat(starts, len(WIDTHS), axis=0), np.zeros((3, size))])
        widths = np.concatenate([np.tile(WIDTHS, len(TURNS)), np.zeros(3)])
        phase = np.concatenate([np.tile(np.arange(len(WIDTHS)), len(TURNS)), np.full(3, len(WIDTHS))])
        none = fit._replace(misfit=jnp.full_like(fit.misfit, jnp.inf))
        rows = (jnp.asarray(vectors, last.dtype), jnp.asarray(widths, last.dtype), jnp.asarray(phase))
        (_, best, at), _ = jax.lax.scan(again, (none, none, last), rows)
        return best, at

    def fits(one: Fit) -> Array:
        return one.sums.inliers / jnp.maximum(one.sums.matched, 1)

    some = fit.sums.matched >= config.least
    astray = leads & some & (fits(fit) < ASTRAY * usual) & (params.search > 0)
    other, at = jax.lax.cond(astray, search, lambda: (fit, last))
    found = astray & (fits(other) > FOUND * usual) & (other.misfit < BETTER * fit.misfit)
    fit, last = jax.tree.map(lambda a, b: jnp.where(found, a, b), (other, at), (fit, last))
    lost = leads & some & (fits(fit) < AMISS * usual)
    # Without the first link, which is looked for, others find themselves anywhere.
    unsure = ~leads & (carry.covariance[3, 3] > (params.search / 2) ** 2) & (params.search > 0)
    bad = lost | unsure | amiss(config, fit.sums)
    kept = fit._replace(
        correction=jnp.where(bad, 0, fit.correction),
        covariance=jnp.where(bad, jnp.where(lost, prior, carry.covariance), fit.covariance),
    )
    return kept, jnp.where(bad, 0, last), lost | unsure


def register(
    body: Body, config: Config, params: Any, carry: Carry, pose: Pose, points: Points, spare: Array,
    parts: int, turn: Array, doubt: Array, leads: Array, usual: Array, turned: Turned | None,
) -> tuple[Carry, Seen, Any]:  # fmt: skip
    """Iterate plane search and update until the link stays where it is, from the best of several starts at first.

    A joint of unknown bias is tried at biases over its whole prior, with all zones: from the middle of it planes two
    metres off are missed by more than lies between one and the next, and the update ends in the wrong one.

    Args:
        body: the robot.
        config: sizes.
        params: the system's.
        carry: what the links before leave.
        pose: the link's, predicted.
        points: what it sees.
        spare: (6, 6) covariance of what its points do not tell of it.
        parts: in how many steps all zones take part.
        turn: () int32, whose turn it is.
        doubt: (6,) variances of a free root's prediction by which the first search looks farther.
        leads: () bool, whether this link says where a free root is.
        usual: () share of that link's points that fitted so far.
        turned: where turns of sensors are estimated.

    Returns:
        Belief and map, what was seen, and what `learned` takes of it.
    """
    covariance, free = carry.covariance, body.root is not None
    once = partial(_once, body, config, params, carry, pose, points, spare, parts, turned)
    slack = jnp.where(leads, doubt, 0) if free else None

    def size(v: Array) -> Array:
        v = jax.lax.stop_gradient(v)
        turned, travelled = product(pose.turn, v), product(pose.travel, v)
        return jnp.max(jnp.abs(travelled)) + REACH * jnp.max(jnp.abs(turned))

    direction, unknown = _doubt(covariance, pose, body.size - len(body.joints))

    def again(state: Any, row: tuple[Array, Array, Array]) -> tuple[Any, None]:
        fit, last, (least, best, total), count = state
        offset, part, trial = row
        start = jnp.where(trial, offset * direction, jnp.where(count == 0, best, fit.correction))
        more = size(fit.correction - last) > STEP
        if slack is None:
            width = None
        else:  # What was matched with a wide gate is matched once more with the narrow one.
            more, width = more | ((count == 1) & jnp.any(slack > 0)), jnp.where(count == 0, slack, 0)
        needed = jnp.where(trial, unknown & (part < parts), (count == 0) | more)
        new = jax.lax.cond(needed, lambda: once(covariance, start, jnp.where(trial, part, turn), width), lambda: fit)
        total = jnp.where(part == 0, 0, total) + new.misfit
        # Of starts that fit alike the first counts: what is left of a sum's rounding must not choose.
        better = trial & needed & (part == parts - 1) & (total < (1 - ALIKE) * least - POINTS)
        found = (jnp.where(better, total, least), jnp.where(better, start, best), total)
        worked = needed & ~trial
        return (new, jnp.where(worked, start, last), found, count + worked.astype(jnp.int32)), None

    def block(state: Any, rows: tuple[Array, Array, Array]) -> tuple[Any, None]:
        trial = rows[2][0]
        return jax.lax.cond(unknown | ~trial, lambda: jax.lax.scan(again, state, rows)[0], lambda: state), None

    # Trials and iterations are one scan, so that their program is there once; trials are left out by whole blocks.
    zero, none = jnp.zeros(len(covariance), covariance.dtype), jnp.int32(0)
    nothing = jax.tree.map(jnp.zeros_like, jax.eval_shape(once, covariance, zero, turn, slack).sums)
    first = (Fit(zero, covariance, nothing, zero[0], zero[0], zero[0]), zero, (zero[0] + jnp.inf, zero, zero[0]), none)
    rows = jax.tree.map(lambda x: jnp.asarray(x).reshape(-1, config.rounds), _plan(parts, config.rounds, zero.dtype))
    (fit, last, _, count), _ = jax.lax.scan(block, first, rows)
    lost = jnp.bool_(False)
    if free:
        fit, last, lost = _found_again(config, params, carry, fit, last, leads, usual, once, turn)
    settled, told = size(fit.correction - last) <= 4 * STEP, fit.sums._replace(aims=None)
    seen = Seen(told, fit.odd, fit.surprise, count, settled, jnp.bool_(True), lost)
    right = (told.inliers >= config.least) & ~lost & ~amiss(config, told)
    found = None if turned is None else (fit.sums.aims, fit.correction - last, fit.covariance, right)
    return rebased(body, _arrived(body, carry, fit)), seen, found


def _plan(parts: int, rounds: int, dtype: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows of trials, filled up to a multiple of `rounds` with some of no part, and then of `rounds` iterations.

    Returns:
        Offset of a trial in deviations, its part of the zones (`parts` where it is none), and whether it is a trial.
    """
    spare = -len(TRIALS) * parts % rounds
    offset = np.concatenate([np.repeat(TRIALS, parts), np.zeros(spare + rounds)]).astype(dtype)
    part = np.concatenate([np.tile(np.arange(parts), len(TRIALS)), np.full(spare, parts), np.zeros(rounds, int)])
    return offset, part, np.arange(len(offset)) < len(offset) - rounds


def _arrived(body: Body, carry: Carry, fit: Fit) -> Carry:
    """Move the belief to where an update says."""
    v, after, mounts = fit.correction[: body.size], fit.covariance, carry.mounts
    mean = bodies.retract(body, carry.mean, v)
    if mounts is not None:
        mounts = mounts._replace(ring=mounts.ring + fit.correction[body.size :].reshape(-1, 3))
    if body.root is not None:
        frame = reanchor(bodies.manifold(body), carry.mean, v, mean)
        if mounts is not None:
            frame = jnp.eye(len(after), dtype=v.dtype).at[: body.size, : body.size].set(frame)
        after = symmetric(sandwich(frame, after))
    return carry._replace(mean=mean, covariance=after, mounts=mounts)


def _doubt(covariance: Array, pose: Pose, roots: int) -> tuple[Array, Array]:
    """Return how the state moves (D,) with the least known bias that moves a link, per deviation; is that much?"""
    moves = jnp.sum(pose.turn**2 + pose.travel**2, axis=0) > 0
    bias = jnp.arange(len(moves)) >= roots
    variance = jnp.where(moves & bias, jnp.diagonal(covariance), 0)
    column = jax.lax.dynamic_index_in_dim(covariance, jnp.argmax(variance), axis=1, keepdims=False)
    deviation = jnp.sqrt(jnp.where(jnp.max(variance) > 0, jnp.max(variance), 1))
    return jax.lax.stop_gradient(column / deviation), jnp.max(variance) > DOUBT**2


def rebased(body: Body, carry: Carry) -> Carry:
    """Bend the map to where the unknowns now put it, if one of them changed by `BEND` or more."""
    here = unknowns(carry.mean.bias, carry.mounts)
    change = here - carry.reference
    far = jnp.max(jnp.abs(change), initial=0) >= BEND
    chart, reference = jax.lax.cond(
        far, lambda: (bent(body, carry.chart, carry.links, change), here), lambda: (carry.chart, carry.reference)
    )
    return carry._replace(chart=chart, reference=reference)


__all__ = ["Carry", "Config", "Fit", "Seen", "amiss", "rebased", "register", "subset"]
