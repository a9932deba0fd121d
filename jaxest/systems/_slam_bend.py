"""How a map follows when the biases or the turns of sensors that its points were placed by are believed to be others.

A point carries how each of these unknowns moves it. An unknown that turns a joint turns the axes of all that hangs on
it as well, and whatever moves a point moves it about those axes, so that what it carries changes with the unknowns.
Were it left as when the point was read, it would disagree with what is computed for a link now, and a filter would
learn from the difference: of a robot whose first link sees nothing, the bias of its first joint, which turns room and
robot alike, would seem to be known.
"""

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.filters.kalman.gaussian import product
from jaxest.mapping import VoxelMap, carried, recarried, shift
from jaxest.systems import _slam_body as bodies
from jaxest.systems._slam_body import Body
from jaxest.types import Array


def bent(body: Body, chart: VoxelMap, links: bodies.Links, change: Array) -> VoxelMap:
    """Move a map's points, and what they carry of how they move, to where a change of the unknowns puts them.

    Args:
        body: the robot.
        chart: its map.
        links: the scanned links as they stand; a point moves as if it had been read with them standing so, which is
            how they did stand in the first scans, when the unknowns change most.
        change: (n,) of the biases, or (n + 3 L,) with what the sensors of each link have in common.

    Returns:
        The map, to second order in the change.
    """
    n, count = len(change), len(chart.point)
    kept = carried(chart)
    slope = kept[:, : 3 * n].reshape(count, 3, n)
    turns, carries = (x[:n, :n] for x in _turns(body))
    axes = _axes(body, links)[:, :n]
    above = product(axes * change[None], jnp.asarray(turns, slope.dtype))
    gone = slope * change[None, None]
    below = product(gone.reshape(-1, n), jnp.asarray(carries.T, slope.dtype)).reshape(slope.shape)
    newer = slope + _cross(above[None], slope) + _cross(axes[None], below)
    moved = shift(chart, jnp.sum((slope + newer) * change[None, None], axis=2) / 2)
    return recarried(moved, newer.reshape(count, -1))


def _turns(body: Body) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Say what the unknowns (n + 3 L) do to each other, 0 or 1.

    Returns:
        Which turn the axis of which: joints those beyond them, and the links' sensors, which turn in their link. And
        which turn about their axis what which moves: those as well, themselves, and all three of a link's sensors.
    """
    parent, at = body.robot.topology.body_parent, body.robot.topology.joint_body

    def hangs(link: int, joint: int) -> bool:
        while link > at[joint]:
            link = parent[link]
        return link == at[joint]

    n, links = len(body.joints), len(body.scanned)
    turns = np.zeros((n + 3 * links, n + 3 * links))
    for j, joint in enumerate(body.joints):
        turns[j, :n] = [hangs(at[other], joint) and other > joint for other in body.joints]
        turns[j, n:] = np.repeat([hangs(link, joint) for link in body.scanned], 3)
    own = np.eye(n + 3 * links)
    own[n:, n:] = np.kron(np.eye(links), np.ones((3, 3)))
    return turns, turns + own


def _axes(body: Body, links: bodies.Links) -> Array:
    """Return the axes (3, n + 3 L) about which each unknown turns things, signed, 0 for a slide."""
    roots = body.size - len(body.joints)
    turn = links.turn[:, :, roots : body.size]
    # All links beyond a joint turn about the same axis, the others not at all.
    first = jnp.argmax(jnp.sum(turn**2, axis=1), axis=0)
    joints = jnp.take_along_axis(turn, first[None, None], axis=0)[0]
    return jnp.concatenate([joints, jnp.moveaxis(links.rotation, 0, 1).reshape(3, -1)], axis=1)


def _cross(a: Array, b: Array) -> Array:
    """Cross product along the middle axis."""
    x, y, z = (a[:, i] for i in range(3))
    u, v, w = (b[:, i] for i in range(3))
    return jnp.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)


__all__ = ["bent"]
