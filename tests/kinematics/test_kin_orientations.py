"""Joint coordinates from orientations, and angles of single joints, against MuJoCo-checked kinematics and SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest import kinematics, models
from jaxest.kinematics import orientations
from jaxest.kinematics.movement import scattered, spread
from jaxest.types import NON_FINITE, OK, InputError


@pytest.fixture(scope="module")
def rover():
    return kinematics.load(models.path("rover"))


def placed(robot, seed):
    """A configuration within the limits, coupled joints at their leaders'."""
    q = scattered(robot, jnp.asarray(robot.home), jnp.asarray(float(seed)))
    return kinematics.expand(robot, q[np.array(robot.topology.free)])


def test_rotations_are_those_of_the_kinematics(rover, x64):
    frames = tuple(range(len(rover.frame_names)))
    q = placed(rover, 2)
    found, slopes = orientations.rotations(rover, q, frames)
    expected = kinematics.forward(rover, q).quaternion
    np.testing.assert_allclose(np.abs(np.sum(np.asarray(found * expected), axis=1)), 1, atol=1e-14)
    for i in (0, 4, 9, 12):
        np.testing.assert_allclose(slopes[i], kinematics.jacobian(rover, q, i)[:3], atol=1e-14)
    head, palm = "head", "palm"
    relative, _ = orientations.rotations(rover, q, [palm], [head])
    both = kinematics.forward(rover, q, [head, palm]).quaternion
    wanted = Rotation.from_quat(both[0], scalar_first=True).inv() * Rotation.from_quat(both[1], scalar_first=True)
    assert (Rotation.from_quat(np.asarray(relative[0]), scalar_first=True).inv() * wanted).magnitude() < 1e-7


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.slow)], indirect=True)
def test_every_kind_of_joint_is_found_from_its_links(rover, dtype):
    """Free root, ball, hinges and hinges coupled to them; slides and the root's place stay unknown and say so."""
    rover = jax.tree.map(lambda x: np.asarray(x, dtype), rover)
    names = [name for name in rover.frame_names if not name.startswith("site:")]
    home = jnp.asarray(rover.home, dtype)
    solve = jax.jit(
        lambda seen, weight: orientations.fit_orientations(
            rover, names, orientations.Observed(seen, weight), home, iterations=25
        )
    )
    weight = np.tile(np.eye(3) * 1e8, (len(names), 1, 1)).astype(dtype)
    for seed in (3, 4):
        q = placed(rover, seed).astype(dtype)
        seen = kinematics.forward(rover, q, names).quaternion
        fit = solve(seen, weight)
        assert int(fit.status) == OK
        assert np.abs(fit.residual).max() < (1e-6 if dtype == "float64" else 2e-4)
        again = kinematics.forward(rover, fit.q, names).quaternion
        np.testing.assert_allclose(np.abs(np.sum(np.asarray(again * seen), axis=1)), 1, atol=1e-6)
        known = np.asarray(fit.known)
        unknown = [i for i in range(rover.nv) if known[i] < 0.5]
        slides = [rover.topology.joint_v[j] for j, kind in enumerate(rover.topology.joint_kind) if kind == "slide"]
        assert unknown == sorted([0, 1, 2, *slides])


def test_covariance_is_that_of_the_errors(x64):
    """400 noisy draws: errors in their own covariance average to the number of joints, 4 +- 3 standard errors."""
    arm = kinematics.load(models.path("arm"))
    names = ["link1", "link2", "link3", "hand", "jaw"]
    q = jnp.array([0.3, 0.5, 0.7, -0.2])
    truth = kinematics.forward(arm, q, names).quaternion
    sigma, runs = 0.02, 400
    turns = Rotation.from_rotvec(np.random.default_rng(0).normal(scale=sigma, size=(runs * 5, 3)))
    noisy = turns * Rotation.concatenate([Rotation.from_quat(np.asarray(truth), scalar_first=True)] * runs)
    seen = jnp.asarray(noisy.as_quat(scalar_first=True).reshape(runs, 5, 4))
    weight = jnp.tile(jnp.eye(3) / sigma**2, (5, 1, 1))
    fit = jax.jit(
        jax.vmap(lambda s: orientations.fit_orientations(arm, names, orientations.Observed(s, weight), q, iterations=4))
    )(seen)
    error = np.asarray(fit.q) - np.asarray(q)
    nees = np.einsum("ri,rij,rj->r", error, np.linalg.inv(np.asarray(fit.covariance)), error)
    assert abs(nees.mean() - 4) < 3 * np.sqrt(2 * 4 / runs)


def test_what_no_heading_tells_is_said(x64):
    """With the vertical alone a joint about the vertical is unknown, those about horizontal axes are found."""
    arm = kinematics.load(models.path("arm"))
    names = ["link1", "link2", "link3"]
    q = jnp.array([0.4, 0.5, 0.7, 0.0])
    seen = kinematics.forward(arm, q, names).quaternion
    tilt = jnp.tile(jnp.diag(jnp.array([1e6, 1e6, 0.0])), (3, 1, 1))
    start = jnp.array([0.4, 0.1, 0.1, 0.0])
    fit = orientations.fit_orientations(arm, names, orientations.Observed(seen, tilt), start)
    assert fit.known[0] < 1e-3
    assert np.all(np.asarray(fit.known[1:3]) > 0.999)
    np.testing.assert_allclose(fit.q[1:3], q[1:3], atol=1e-5)
    assert np.allclose(fit.q[0], 0.4, atol=1e-6)


def test_bad_observations(x64):
    arm = kinematics.load(models.path("arm"))
    one = jnp.array([[1.0, 0, 0, 0]])
    with pytest.raises(ValueError, match=r"observed: shapes \(2, 4\).*expected \(1, 4\)"):
        orientations.fit_orientations(
            arm, ["hand"], orientations.Observed(jnp.tile(one, (2, 1)), np.eye(3)[None]), arm.home
        )
    with pytest.raises(InputError, match="did you mean 'hand'"):
        orientations.fit_orientations(arm, ["hnd"], orientations.Observed(one, np.eye(3)[None]), arm.home)
    with pytest.raises(ValueError, match="references: got 2"):
        orientations.rotations(arm, arm.home, ["hand"], ["link1", "link2"])
    fit = orientations.fit_orientations(arm, ["hand"], orientations.Observed(one * np.nan, np.eye(3)[None]), arm.home)
    assert int(fit.status) == NON_FINITE
    np.testing.assert_allclose(fit.q, arm.home, atol=1e-12)
    assert np.isfinite(np.asarray(fit.covariance)).all()


def test_the_fit_moves_with_its_coupled_joints(x64):
    gripper = kinematics.load(models.path("gripper"))
    moving = tuple(j for j, n in enumerate(gripper.joint_names) if n == "left_q1")
    across = spread(gripper, moving, jnp.asarray(gripper.home))
    assert np.count_nonzero(across) == 2  # the roll joint and its follower


def test_roll_pitch_yaw(dtype):
    random = Rotation.random(500, rng=np.random.default_rng(1))
    found = jax.vmap(kinematics.roll_pitch_yaw)(random.as_quat(scalar_first=True).astype(dtype))
    yaw, pitch, roll = random.as_euler("ZYX").T
    for value, expected in zip(found[:3], (roll, pitch, yaw), strict=True):
        off = np.angle(np.exp(1j * (np.asarray(value, float) - expected)))
        assert np.abs(off).max() < (1e-9 if dtype == "float64" else 2e-2)
        assert np.median(np.abs(off)) < 1e-6
    for sign in (1, -1):
        up = Rotation.from_euler("ZYX", [0.7, sign * np.pi / 2, 0.2])
        locked = kinematics.roll_pitch_yaw(up.as_quat(scalar_first=True).astype(dtype))
        assert bool(locked.gimbal)
        again = Rotation.from_euler("ZYX", [float(locked.yaw), float(locked.pitch), float(locked.roll)])
        assert (up.inv() * again).magnitude() < 2e-3
    gradient = jax.grad(lambda q: sum(kinematics.roll_pitch_yaw(q)[:3]))(
        jnp.asarray(up.as_quat(scalar_first=True), dtype)
    )
    assert np.isfinite(np.asarray(gradient)).all()


def test_the_signed_angle_is_right_however_the_sensors_are_mounted(x64):
    """Sensors 20 degrees off: eq. 24 is wrong by degrees, the signed angle about the calibrated axis by rounding."""
    random = np.random.default_rng(2)
    angles = np.linspace(-3.1, 3.1, 41)
    axis = np.array([1.0, 0, 0])

    def one(zero, now, axis):
        turned = kinematics.since_zero(zero, now)
        return kinematics.hinge_angle(turned, axis), kinematics.roll_pitch_yaw(turned).roll

    measure, worst = jax.jit(jax.vmap(one, (None, 0, None))), 0.0
    for _ in range(20):
        tilts = random.normal(size=(2, 3))
        first, second = (Rotation.from_rotvec(np.deg2rad(20) * v / np.linalg.norm(v)) for v in tilts)
        now = first.inv() * Rotation.from_rotvec(angles[:, None] * axis) * second
        zero = (first.inv() * second).as_quat(scalar_first=True)
        found, plain = measure(zero, now.as_quat(scalar_first=True), second.inv().apply(axis))
        np.testing.assert_allclose(found, angles, atol=1e-12)
        worst = max(worst, np.abs(np.angle(np.exp(1j * (np.asarray(plain) - angles)))).max())
    assert worst > np.deg2rad(3)
