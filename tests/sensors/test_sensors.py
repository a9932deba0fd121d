"""Sensors against densities from elsewhere, their rows against automatic derivatives, and what is missing."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from scipy import integrate, stats
from scipy.spatial.transform import Rotation
from scipy.special import ive

from jaxest import kinematics, models, sensors
from jaxest.distributions import bingham
from jaxest.kinematics.moving import moving_frames
from jaxest.sensors import KINDS, Sensor
from jaxest.types import InputError, Reading

FRAMES = ("site:imu2", "site:end_effector")
MOUNTING = np.array([0.5, -0.5, 0.1, 0.7]) / np.linalg.norm([0.5, -0.5, 0.1, 0.7])
PARAMS = {
    "joint_angle": sensors.joint_angle.Params(np.array([15.0, 3.0, 20.0, 8.0]), 0.1),
    "link_orientation": sensors.link_orientation.Params(np.array([0.0, -300.0, -800.0, -20.0]), MOUNTING),
    "link_position": sensors.link_position.Params(np.array([0.01, 0.02, 0.04]), np.array([0.1, -0.2, 0.05])),
    "gravity_direction": sensors.gravity_direction.Params(50.0, MOUNTING),
    "relative_orientation": sensors.relative_orientation.Params(
        np.array([0.0, -300.0, -800.0, -20.0]), MOUNTING, MOUNTING[[1, 0, 3, 2]]
    ),
}
PARAMS["slide_position"] = sensors.slide_position.Params(np.array([0.01, 0.3, 0.02, 0.1]), 0.1)
PARAMS["end_effector_pose"] = sensors.end_effector_pose.Params(PARAMS["link_position"], PARAMS["link_orientation"])
Q = np.array([0.3, -0.5, 0.9, 0.2])
OTHER = np.array([0.5, -0.3, 1.0, 0.1])
NAMES = sorted(KINDS)


@cache
def arm():
    return kinematics.load(models.path("arm"))


def look(kind, q):
    """What a sensor of this kind looks at."""
    return q if kind.FRAMES == 0 else kinematics.forward(arm(), q, FRAMES[-kind.FRAMES :])


def cast(tree, dtype):
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), tree)


@cache
def evaluated(name, dtype):
    """Log-densities and rows at Q of a reading taken at OTHER, with the derivative of the residual."""
    kind = KINDS[name]

    def everything(params, q, other):
        reading = Reading(kind.predict(params, look(kind, other)), jnp.asarray(True))
        hidden = Reading(jnp.full_like(reading.value, jnp.nan), jnp.asarray(False))

        def residual(q, reading):
            return kind.residual(params, reading, look(kind, q))

        def log_prob(q, reading):
            return kind.log_prob(params, reading, look(kind, q))

        jacobian = jnp.eye(4, dtype=q.dtype)
        if kind.FRAMES:
            jacobian = moving_frames(arm(), q, FRAMES[-kind.FRAMES :]).jacobian
        given = [kind.rows(params, r, look(kind, q), jacobian) for r in (reading, hidden)]
        slope = jax.jacfwd(residual)(q, reading)
        values = [log_prob(q, reading), log_prob(other, reading)]
        missing = jax.value_and_grad(log_prob)(q, hidden), residual(q, hidden), given[1]
        by_params = jax.grad(lambda p: kind.log_prob(p, hidden, look(kind, q)))(params)
        return reading.value, values, residual(q, reading), slope, given[0], (missing, by_params)

    args = cast((PARAMS[name], Q, OTHER), dtype)
    return jax.tree.map(np.asarray, jax.jit(everything, compiler_options=QUICK)(*args))


@pytest.mark.parametrize("name", NAMES)
def test_rows_are_the_residual_and_its_derivative(name, dtype):
    _, values, residual, slope, (value, rows), _ = evaluated(name, dtype.name)
    tolerance = 300 * np.finfo(dtype).eps * max(1.0, np.abs(slope).max())
    np.testing.assert_allclose(value, residual, atol=tolerance)
    np.testing.assert_allclose(rows, slope, atol=tolerance)
    assert np.abs(slope).max() > 0.5
    # At OTHER the reading is as predicted, so that the residual is 0 there.
    scale = max(1.0, np.sum(residual**2))
    np.testing.assert_allclose(values[1] - values[0], np.sum(residual**2) / 2, atol=300 * np.finfo(dtype).eps * scale)


@pytest.mark.parametrize("name", NAMES)
def test_what_is_missing_is_exactly_nothing(name, dtype):
    missing = evaluated(name, dtype.name)[-1]
    for leaf in jax.tree.leaves(missing):
        assert leaf.dtype == dtype
        np.testing.assert_array_equal(leaf, 0)


def rotation(wxyz):
    return Rotation.from_quat(np.asarray(wxyz)[..., [1, 2, 3, 0]])


def poses(q):
    found = jax.jit(lambda q: kinematics.forward(arm(), q, FRAMES), compiler_options=QUICK)(jnp.asarray(q))
    return jax.tree.map(np.asarray, found)


def test_densities_are_those_of_elsewhere(x64):
    value, (density, _), *_ = evaluated("joint_angle", "float64")
    expected = stats.vonmises.logpdf(value - 0.1 - Q, PARAMS["joint_angle"].concentration).sum()
    np.testing.assert_allclose(density, expected, atol=1e-11)

    value, (density, _), *_ = evaluated("slide_position", "float64")
    expected = stats.norm.logpdf(value, Q + 0.1, np.sqrt(PARAMS["slide_position"].variance)).sum()
    np.testing.assert_allclose(density, expected, atol=1e-11)

    frames = poses(Q)
    turns = rotation(frames.quaternion)
    value, (density, _), *_ = evaluated("link_position", "float64")
    point = frames.position[1] + turns[1].apply(PARAMS["link_position"].offset)
    expected = stats.multivariate_normal.logpdf(value, point, np.diag([0.01, 0.02, 0.04]))
    np.testing.assert_allclose(density, expected, atol=1e-11)

    up = (turns[1] * rotation(MOUNTING)).inv().apply([0, 0, 1])
    value, (density, _), *_ = evaluated("gravity_direction", "float64")
    np.testing.assert_allclose(density, stats.vonmises_fisher(up, 50.0).logpdf(value), atol=1e-10)


def test_an_accelerometer_that_says_nothing(dtype):
    """A concentration of 0, which `check_params` takes, is the uniform density of the sphere."""
    kind, frames = sensors.gravity_direction, cast(poses(Q), dtype)
    frames = kinematics.Frames(*(x[1:2] for x in frames))
    params = cast(kind.Params(0.0), dtype)
    reading = Reading(jnp.asarray([0.0, 3.0, 4.0], dtype), True)
    np.testing.assert_allclose(kind.log_prob(params, reading, frames), -np.log(4 * np.pi), rtol=1e-6)
    drawn = jax.vmap(lambda key: kind.sample(key, params, frames))(jax.random.split(jax.random.key(0), 4000))
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, rtol=1e-5)
    # A component of a uniform direction has the variance 1/3: 4.5 standard errors of its mean.
    assert np.abs(np.mean(drawn, axis=0)).max() < 4.5 / np.sqrt(3 * 4000)


def test_the_error_of_an_orientation_is_about_the_worlds_axes(x64):
    """SciPy's product in the paper's order, and the normaliser by quadrature over the sphere S^3."""
    lam = PARAMS["link_orientation"].lam
    turns = rotation(poses(Q).quaternion)
    value, (density, _), *_ = evaluated("link_orientation", "float64")
    e = (rotation(value) * (turns[1] * rotation(MOUNTING)).inv()).as_quat()[[3, 0, 1, 2]]

    def inner(t):  # (w, z) and (x, y) as two circles, the angles within each in closed form
        c, s = np.cos(t) ** 2, np.sin(t) ** 2
        first, second = (lam[0] + lam[3]) / 2 * c, (lam[1] + lam[2]) / 2 * s
        one, two = (lam[0] - lam[3]) / 2 * c, (lam[1] - lam[2]) / 2 * s
        return np.cos(t) * np.sin(t) * np.exp(first + second + abs(one) + abs(two)) * ive(0, one) * ive(0, two)

    total = 4 * np.pi**2 * integrate.quad(inner, 0, np.pi / 2, points=[0.02, 0.1], epsabs=0, epsrel=1e-10)[0]
    np.testing.assert_allclose(density, np.sum(lam * e * e) - np.log(total), atol=1e-7)

    first, second = turns[0] * rotation(MOUNTING), turns[1] * rotation(MOUNTING[[1, 0, 3, 2]])
    value, (density, _), *_ = evaluated("relative_orientation", "float64")
    e = (rotation(value) * (first.inv() * second).inv()).as_quat()[[3, 0, 1, 2]]
    np.testing.assert_allclose(density, np.sum(lam * e * e) - np.log(total), atol=1e-7)


def test_axisymmetric_leaves_the_worlds_yaw_free(x64):
    kind = sensors.link_orientation
    frames = kinematics.forward(arm(), jnp.asarray(Q), FRAMES[1:])
    turn = Rotation.from_euler("z", 0.7) * rotation(frames.quaternion[0])
    reading = Reading(jnp.asarray(turn.as_quat()[[3, 0, 1, 2]]), jnp.asarray(True))
    free, fixed = (kind.Params(lam) for lam in (kind.axisymmetric(), kind.unimodal()))
    np.testing.assert_allclose(kind.residual(free, reading, frames), 0, atol=1e-12)
    np.testing.assert_allclose(np.sum(kind.residual(fixed, reading, frames) ** 2) / 2, 800 * np.sin(0.35) ** 2)


@pytest.mark.parametrize("name", NAMES)
def test_samples_lie_as_the_density_says(name):
    """The mean of |r|^2 is that of the density, within 4.5 standard errors of 4000 draws."""
    kind, count = KINDS[name], 4000
    params = cast(PARAMS[name], jnp.float32)

    def one(key, view):
        value = kind.sample(key, params, view)
        return jnp.sum(kind.residual(params, Reading(value, jnp.asarray(True)), view) ** 2)

    view = look(kind, jnp.asarray(Q, jnp.float32))
    draw = jax.jit(jax.vmap(one, (0, None)), compiler_options=QUICK)
    squares = np.asarray(draw(jax.random.split(jax.random.key(3), count), view), float)
    expected = {
        "joint_angle": sum(2 * k * (1 - mean_cosine(k)) for k in PARAMS["joint_angle"].concentration),
        "link_position": 3.0,
        "slide_position": 4.0,
        "gravity_direction": 100 * (1 - (1 / np.tanh(50.0) - 1 / 50.0)),
        "link_orientation": bingham_energy(),
        "relative_orientation": bingham_energy(),
        "end_effector_pose": 3.0 + bingham_energy(),
    }[name]
    assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(count)


def mean_cosine(k):
    return ive(1, k) / ive(0, k)


def bingham_energy():
    """E of -2 sum lam_i e_i^2, from the oracle-tested moments."""
    lam = jnp.asarray(PARAMS["link_orientation"].lam, jnp.float32)
    return float(-2 * jnp.sum(lam * bingham.second_moments(lam)))


@pytest.mark.parametrize("robot", ["arm", "rover"])
def test_moving_frames_are_forward_and_jacobian(robot, x64):
    robot = kinematics.load(models.path(robot))
    names = robot.frame_names[:: max(1, len(robot.frame_names) // 5)]
    columns = [robot.nv - 1, 0]

    def everything(q):
        each = jnp.stack([kinematics.jacobian(robot, q, name) for name in names])
        return moving_frames(robot, q, names), moving_frames(robot, q, names, columns), each

    random = np.random.default_rng(0)
    q = jnp.asarray(robot.home + 0.3 * random.normal(size=robot.nq))
    found, part, each = jax.jit(everything, compiler_options=QUICK)(q)
    np.testing.assert_allclose(found.jacobian, each, atol=1e-12)
    np.testing.assert_allclose(part.jacobian, each[:, :, np.array(columns)], atol=1e-12)
    frames = kinematics.forward(robot, q, names)
    np.testing.assert_allclose(found.frames.position, frames.position, atol=1e-12)
    np.testing.assert_allclose(found.frames.quaternion, frames.quaternion, atol=1e-12)


def test_bad_sensors_are_named():
    kind = sensors.measurement_type
    with pytest.raises(InputError, match=r"kind 'link_orientaton' does not exist; did you mean 'link_orientation'"):
        kind([Sensor("link_orientaton", "imu", ("hand",))])
    with pytest.raises(InputError, match=r"'imu': a link_orientation looks at 1 frame\(s\), got 0"):
        kind([Sensor("link_orientation", "imu")])
    with pytest.raises(InputError, match=r"'a': there are two of this name"):
        kind([Sensor("joint_angle", "a"), Sensor("joint_angle", "a")])
    with pytest.raises(InputError, match="'dt': expected a name"):
        kind([Sensor("joint_angle", "dt")])


@pytest.mark.parametrize(
    ("name", "params", "message"),
    [
        ("joint_angle", sensors.joint_angle.Params(-1.0), "concentration is -1.0*, expected at least 0"),
        ("joint_angle", sensors.joint_angle.Params(1.0, np.nan), "offset is nan, expected finite numbers"),
        ("link_position", sensors.link_position.Params(np.array([1.0, 0, 1])), "variance is .*, expected positive"),
        ("link_orientation", sensors.link_orientation.Params(mounting=np.ones(4)), "mounting is .*unit quaternion"),
        ("link_orientation", sensors.link_orientation.Params(mounting=np.array([0, 0, 1.0])), "mounting is .*unit"),
        ("link_orientation", sensors.link_orientation.Params(np.array([0.0, 5, 0, 0])), "lam is .*above the first$"),
        ("end_effector_pose", PARAMS["end_effector_pose"]._replace(
            position=sensors.link_position.Params(np.array([1.0, -1, 1]))), "position: variance"),
    ],
)  # fmt: skip
def test_bad_parameters_are_named(name, params, message):
    frames = FRAMES[-KINDS[name].FRAMES :] if KINDS[name].FRAMES else ()
    listed = [Sensor(name, "it", frames, params)]
    with pytest.raises(InputError, match=f"sensor 'it': {message}"):
        sensors.check_params(listed, sensors.default_params(listed))
    sensors.check_params([Sensor(name, "it", frames)], sensors.default_params([Sensor(name, "it", frames)]))


def test_bad_measurements_are_named():
    listed = [Sensor("link_orientation", "imu", ("hand",))]
    record = sensors.measurement_type(listed)
    turns = Rotation.from_euler("z", np.linspace(0.05, 3.0, 9)[:, None]) * Rotation.from_euler("x", 0.1)
    good = turns.as_quat()[:, [3, 0, 1, 2]]
    valid, dt = np.ones(9, bool), np.full(9, 0.01)
    sensors.check_measurements(listed, record(Reading(good, valid), dt))
    bad = good.copy()
    bad[3] *= 1.1
    with pytest.raises(InputError, match=r"sensor 'imu': row 3 is a quaternion of length 1.1, expected 1"):
        sensors.check_measurements(listed, record(Reading(bad, valid), dt))
    bad[3] = np.nan
    with pytest.raises(InputError, match=r"sensor 'imu': row 3 is .*expected finite"):
        sensors.check_measurements(listed, record(Reading(bad, valid), dt))
    sensors.check_measurements(listed, record(Reading(bad, np.arange(9) != 3), dt))
    with pytest.raises(InputError, match=r"dt: row 2 is -1.0 s"):
        sensors.check_measurements(listed, record(Reading(good, valid), np.where(np.arange(9) == 2, -1.0, dt)))
    start = Rotation.from_euler("xyz", np.outer(np.linspace(0.01, 1, 9), [-0.5, 0.4, 0.2]))
    with pytest.raises(InputError, match="looks like xyzw; expected wxyz"):
        sensors.check_measurements(listed, record(Reading(start.as_quat(), valid), dt))
