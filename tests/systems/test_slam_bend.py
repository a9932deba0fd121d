"""A map that follows what its points were placed by, against points placed anew."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from slam_models import robot, sensors

from jaxest.manifolds import so3
from jaxest.mapping import Hashed, carried, empty, insert
from jaxest.systems import _slam_body as bodies
from jaxest.systems import slam
from jaxest.systems._slam_bend import bent
from jaxest.systems._slam_rows import Pose, point_slope, world


def placed(body, reading, unknowns, link, local, ray):
    """Points of a scanned link, how the unknowns move them, and all links."""
    n = len(body.joints)
    mean = bodies.home(body, jnp.result_type(float))._replace(bias=unknowns[:n])
    links = bodies.links(body, mean, reading, body.scanned)
    pose = Pose(*(x[link] for x in links))
    ring = slice(n + 3 * link, n + 3 * link + 3)
    ray = ray @ so3.exp(unknowns[ring]).T
    x = world(pose, local + ray)
    slope = jnp.zeros((len(local), 3, len(unknowns)))
    slope = slope.at[:, :, :n].set(point_slope(pose, x))
    arm = ray @ pose.rotation.T
    swing = jnp.stack([jnp.cross(pose.rotation[:, i][None], arm) for i in range(3)], axis=2)
    return x, slope.at[:, :, ring].set(swing), links


@pytest.mark.parametrize("link", [0, 2, 3])
def test_points_and_their_slopes_are_those_of_the_new_unknowns(x64, link):
    """Hinges, a slide, a branch, and the turns that a link's sensors share: halving the change quarters what is off."""
    system = slam.build(robot(), sensors(2, 2), align=True)
    body = system.step.args[0]
    rng = np.random.default_rng(link)
    n = len(body.joints)
    reading = jnp.asarray(rng.uniform(-0.5, 0.5, n))
    first = jnp.zeros(n + 3 * len(body.scanned)).at[:n].set(0.02)
    local, ray = (jnp.asarray(rng.uniform(-1, 1, (12, 3))) for _ in range(2))
    layout, change = Hashed(0.01), jnp.asarray(rng.normal(size=len(first))) * 0.04
    x, slope, links = placed(body, reading, first, link, local, ray)

    def off(step):
        chart = insert(layout, empty(layout, 64, 3 * len(first), jnp.float64), x, jnp.ones(12, bool),
                       slope.reshape(12, -1))  # fmt: skip
        assert int(chart.used) == 12
        chart = bent(body, chart, links, step)
        there, turned, _ = placed(body, reading, first + step, link, local, ray)
        kept = carried(chart)[:12].reshape(12, 3, -1)
        return np.array([jnp.abs(chart.point[:12] - there).max(), jnp.abs(kept - turned).max()])

    still = jnp.abs(placed(body, reading, first + change, link, local, ray)[1] - slope).max()
    whole, half = off(change), off(change / 2)
    assert whole[1] < 0.15 * still
    assert np.all(whole / half > 3)  # second order at least


@pytest.mark.slow
def test_what_no_motion_tells_stays_unknown():
    """An arm whose root is blind: the bias of its first joint turns the room with the robot."""
    free = slam.build(
        robot(), [s for s in sensors(4, 4) if s.frame in ("a", "b")], layout=Hashed(0.25, (32, 32, 16)), capacity=1500
    )
    draw = jax.jit(lambda key: free.simulate(free.default_params, key=key, steps=40, amplitude=0.4))
    given, _ = draw(jax.random.key(2))
    step = jax.jit(free.step)
    state = free.init(free.default_params)
    for k in range(40):
        state, info = step(free.default_params, state, jax.tree.map(lambda x, k=k: x[k], given))
    deviation = np.asarray(info.bias_deviation)
    assert deviation[0] > 0.095
    assert abs(float(info.bias[0])) < 0.01
    assert deviation[1] < 0.02
    assert abs(float(info.bias[1]) - 0.05) < 0.01
