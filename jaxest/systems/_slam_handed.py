"""One link of the filter that hands poses from parent to child: predicted from its parent, updated with its points.

Source: Iwao 2025, eqs. 1-31, with the errata's transposes, and biases about the joint's axis.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.filters import kalman
from jaxest.filters.kalman import Gaussian, independent, information_gain
from jaxest.filters.kalman.gain import Gained
from jaxest.filters.kalman.gaussian import product
from jaxest.manifolds import Euclidean, quaternion, se3
from jaxest.manifolds import product as products
from jaxest.mapping import VoxelMap
from jaxest.systems._slam_hang import Chain
from jaxest.systems._slam_register import Config
from jaxest.systems._slam_rows import Points, Pose, match, moved, sums
from jaxest.types import Array

TURNED = 1e-3  # m or rad: an update has converged when it moves less
NODE = products.of((se3, Euclidean((1,))))
PAIR = products.of((se3, Euclidean((1,)), Euclidean((1,))))


class Links(NamedTuple):
    """Beliefs of L links; a link's element is (pose, bias), its tangent [rotation, translation, bias] in the link."""

    pose: se3.Pose
    """(L, ...) link to world."""
    bias: Array
    """(L, 1)."""
    covariance: Array
    """(L, 7, 7)."""


def predict(params: Any, own: Links, hinged: Chain, links: Links, reading: Array, free: float, root: Array) -> Gaussian:
    """Carry the parent's belief and the link's past bias to the link; the root's own past to the root.

    Args:
        params: the system's.
        own: the link's belief after the last step.
        hinged: how it hangs on its parent.
        links: beliefs of all links, of this step for those before it.
        reading: (n,) rad or m, encoders.
        free: 1 where the root is free, 0 where it is fixed.
        root: () bool, whether the link is the root.

    Returns:
        The belief of (pose, bias).
    """
    up = jnp.maximum(hinged.parent, 0)
    parent, spread = jax.tree.map(
        lambda x: jax.lax.dynamic_index_in_dim(x, up, keepdims=False), (links.pose, links.covariance)
    )
    dtype = spread.dtype

    def hang(x: Any) -> Any:
        (pose, bias, noise) = x
        coordinate = reading[hinged.joint] - bias[0] + noise[0]
        turn = quaternion.exp(jnp.where(hinged.hinge, coordinate, 0) * hinged.axis.astype(dtype))
        anchor = hinged.anchor.astype(dtype)
        slid = jnp.where(hinged.hinge, 0, coordinate) * hinged.axis.astype(dtype)
        own = se3.Pose(turn, jnp.asarray(anchor - quaternion.rotate(turn, anchor) + slid))
        offset = jax.tree.map(lambda v: v.astype(dtype), hinged.offset)
        return se3.compose(se3.compose(pose, offset), own), bias

    past = Gaussian(own.bias, own.covariance[6:, 6:] + params.bias_walk**2)
    noise = Gaussian(jnp.zeros(1, dtype), jnp.full((1, 1), params.encoder**2))
    both = independent(Gaussian(parent, spread[:6, :6]), past, noise)
    hung = kalman.predict(PAIR, both, hang, target=NODE)
    walk = jnp.zeros(7, dtype).at[:6].set(free * params.root_walk**2)
    still = Gaussian((own.pose, own.bias), own.covariance + jnp.diag(walk))
    return jax.tree.map(lambda a, b: jnp.where(root, a, b), still, hung)


def update(
    config: Config, params: Any, rows: Any, prior: Gaussian, chart: VoxelMap, points: Points
) -> tuple[Gaussian, Any]:
    """Iterate over the link's own 7 numbers; planes are looked for at each iteration that moves the link.

    Args:
        config: sizes.
        params: the system's.
        rows: parameters of `systems.slam`, by which points are matched with planes.
        prior: the link's belief, as `predict` returned it.
        chart: the map.
        points: the link's.

    Returns:
        The belief after, and of the last iteration: inliers, how many iterations there were, whether they settled,
        H' R^-1 H of the pose (6, 6) and the log-density of the distances.
    """
    dtype = prior.covariance.dtype
    pose = prior.mean[0]
    turn = quaternion.to_matrix(pose.rotation)
    wide = jnp.zeros((3, 7), dtype)
    start = Pose(pose.translation, turn, wide.at[:, :3].set(turn), wide.at[:, 3:6].set(turn))
    none = jnp.zeros((6, 6), dtype)

    def once(v: Array) -> Any:
        at = moved(start, v)
        found = match(config.layout, chart, rows, at, points, jnp.zeros(0, dtype), prior.covariance)
        found = found._replace(weight=jnp.where(found.weight > 0, 1 / params.variance, 0))
        s = sums(found, points, none)
        enough = s.inliers >= config.least
        information, pull = jnp.where(enough, s.information, 0), jnp.where(enough, s.pull, 0)
        gained = information_gain(prior.covariance, information, pull + product(information, v))
        innovation, weight = found.residual - product(found.design, v), jnp.where(enough, found.weight, 0)
        return gained.correction, gained.covariance, s.inliers, s.pose, log_density(gained, innovation, weight)

    def again(state: Any, _: None) -> Any:
        result, last, count = state
        far = (count == 0) | (jnp.max(jnp.abs(jax.lax.stop_gradient(result[0] - last))) > TURNED)
        new = jax.lax.cond(far, lambda: once(result[0]), lambda: result)
        return (new, jnp.where(far, result[0], last), count + far.astype(jnp.int32)), None

    zero = jnp.zeros(7, dtype)
    (result, last, count), _ = jax.lax.scan(again, (once(zero), zero, jnp.int32(1)), None, length=config.rounds - 1)
    v, covariance, inliers, information, density = result
    after = Gaussian(NODE.retract(prior.mean, v), covariance)
    settled = jnp.max(jnp.abs(v - last)) <= 10 * TURNED
    return after, (inliers, count, settled, information, density)


def log_density(gained: Gained, innovation: Array, weight: Array) -> Array:
    """Return the log-density () of rows that were summed up, given the belief before them.

    Args:
        gained: as `filters.kalman.information_gain` made it of their sums.
        innovation: (n,) residuals at the belief's mean, by the linearisation that was summed up.
        weight: (n,) one over each row's variance; 0 where a row does not count.
    """
    used = weight > 0
    safe = jnp.where(used, weight, 1)
    own = jnp.sum(weight * innovation**2) + jnp.sum(jnp.where(used, jnp.log(2 * jnp.pi / safe), 0))
    return -(own + gained.nis + gained.log_det) / 2


__all__ = ["Links", "log_density", "predict", "update"]
