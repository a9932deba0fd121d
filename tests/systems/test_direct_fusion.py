"""Direct fusion against SciPy's Euler angles, and where it breaks."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest import kinematics, models
from jaxest.manifolds import quaternion as quat
from jaxest.systems import direct_fusion as df

HEADINGS = {"xyz": df.heading_of_x, "yxz": df.heading_of_y}
HINGES = (df.Hinge(1, 0), df.Hinge(2, 1, 0))


@pytest.fixture(scope="module")
def orientations():
    """Orientations of the arm's two IMU links at angles (d,)."""
    robot = kinematics.load(models.path("arm"))
    return jax.jit(lambda q: kinematics.forward(robot, q, ["link2", "link3"]).quaternion)


@pytest.mark.parametrize("order", HEADINGS)
def test_the_yaw_is_that_of_euler_angles(order):
    rotation = Rotation.random(100, rng=np.random.default_rng(3))
    angles = rotation.as_euler(order)  # lower case: about fixed axes
    found = jax.vmap(HEADINGS[order])(jnp.asarray(rotation.as_quat(scalar_first=True)))
    assert np.allclose(found, angles[:, 2], atol=1e-5)
    rest = jax.vmap(lambda q: df.without_yaw(q, HEADINGS[order]))(jnp.asarray(rotation.as_quat(scalar_first=True)))
    angles[:, 2] = 0
    expected = Rotation.from_euler(order, angles)
    off = (Rotation.from_quat(np.asarray(rest), scalar_first=True).inv() * expected).magnitude()
    assert off.max() < 1e-5


@pytest.mark.parametrize("heading", [df.heading_of_x, df.heading_of_y])
def test_a_drifting_yaw_changes_nothing_where_links_tilt_little(orientations, heading):
    q = jnp.array([0.4, 0.5, 0.6, -0.2])
    drift = jnp.array([np.cos(0.7), 0, 0, np.sin(0.7)], q.dtype)
    turned = jax.vmap(lambda p: quat.compose(drift, p))(orientations(q))
    assert np.allclose(df.fuse(q.at[1:3].set(0.0), turned, HINGES, heading), q, atol=1e-5)


def test_one_order_locks_where_a_link_lies_beyond_the_horizontal_and_the_other_does_not(orientations):
    q = jnp.array([0.4, 0.9, 1.1, -0.2])  # the second link tilts by 2 rad
    bad = df.fuse(q, orientations(q), HINGES, df.heading_of_x)
    assert np.allclose(df.fuse(q, orientations(q), HINGES, df.heading_of_y), q, atol=1e-5)
    assert abs(float(bad[2] - q[2])) > 0.5


def test_negative_angles_keep_their_sign(orientations):
    q = jnp.array([-0.3, -0.8, -0.5, 0.0])
    assert np.allclose(df.fuse(q, orientations(q), HINGES), q, atol=1e-5)


def test_links_in_line_have_a_finite_gradient():
    """Where nothing is turned the angle has a corner: its slope there is 0, not NaN."""
    level = np.array([1.0, 0, 0, 0])
    value, slope = jax.value_and_grad(lambda q: df.angle_between(level, q, [0, 1, 0]))(level)
    assert value == 0
    assert np.isfinite(slope).all()
