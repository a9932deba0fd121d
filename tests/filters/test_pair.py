"""The filter of IMU pairs against a loop on matrices in NumPy, and what its corrections of the paper are for."""

import jax
import numpy as np
import pytest
from reference.ref_complementary import rodrigues
from scipy.spatial.transform import Rotation

from jaxest.filters import pair, run
from jaxest.filters.complementary import Imu, Params
from jaxest.types import InputError, Reading

UP, FIELD = np.array([0, 0, 9.81]), np.array([0, 18.0, -41.0])


def reference(gyr, acc, mag, dt, gains, edges, masks):
    """Algorithm 2, corrected, on matrices: gyr, acc, mag (T, n, 3), masks (T, 3, n); R (T, e, 3, 3) and biases."""
    k_p, k_i, l_acc, l_mag = gains
    rotation, levelled, headed = [np.eye(3)] * len(edges), [False] * len(edges), [False] * len(edges)
    bias, found = np.zeros(gyr.shape[1:]), []
    for t in range(len(gyr)):
        drift, moved = np.zeros_like(bias), []
        for e, (i, j) in enumerate(edges):
            r = rotation[e]
            has = [bool(masks[t, s, i] and masks[t, s, j]) for s in range(3)]
            a, b = (acc[t, k] / np.linalg.norm(acc[t, k]) for k in (i, j))
            m, n = (mag[t, k] / np.linalg.norm(mag[t, k]) for k in (i, j))
            error = np.zeros(3)
            if has[1] and levelled[e]:
                error += l_acc * np.cross(b, r.T @ a)
            if has[2] and headed[e]:
                error += l_mag * np.cross(n, r.T @ m)
            omega = k_p * error
            if has[0]:
                omega = omega + (gyr[t, j] - bias[j]) - r.T @ (gyr[t, i] - bias[i])
            drift[j] += error
            drift[i] -= r @ error
            if levelled[e]:
                r = r @ rodrigues(omega * dt[t])
            elif has[1]:
                axis, cosine = np.cross(b, a), a @ b
                r = rodrigues(axis / np.linalg.norm(axis) * np.arctan2(np.linalg.norm(axis), cosine))
                levelled[e] = True
            if has[1] and has[2] and levelled[e] and not headed[e]:
                up = r @ b
                flat = [v - (v @ up) * up for v in (r @ n, m)]
                angle = np.arctan2(np.cross(flat[0], flat[1]) @ up, flat[0] @ flat[1])
                # The shortest rotation between directions that are not exactly level turns about their own normal.
                axis = np.cross(flat[0], flat[1])
                r = rodrigues(axis / np.linalg.norm(axis) * abs(angle)) @ r
                headed[e] = True
            moved.append(r)
        rotation = moved
        bias = bias - k_i * dt[t] * drift
        found.append(np.array(rotation))
    return np.array(found), bias


@pytest.fixture(scope="module")
def wild():
    random = np.random.default_rng(3)
    steps, n = 150, 4
    gyr, acc, mag = random.normal(size=(3, steps, n, 3))
    acc, mag = acc + np.array([3, 2, 5]), 20 * mag + np.array([10, -40, 5])
    return gyr, acc, mag, random.uniform(0.001, 0.1, steps), random.random((steps, 3, n)) > 0.1


@pytest.mark.parametrize("edges", [((0, 1),), ((0, 1), (1, 2), (0, 2), (3, 1))], ids=["one", "loop"])
def test_against_the_loop_on_matrices(wild, edges, dtype):
    gyr, acc, mag, dt, masks = wild
    gains = 0.74, 0.05, 1.0, 0.7
    expected, bias = reference(gyr, acc, mag, dt, gains, edges, masks)
    readings = [
        Reading(np.where(masks[:, s, :, None], x, np.nan).astype(dtype), masks[:, s])
        for s, x in enumerate((gyr, acc, mag))
    ]
    init, step = pair.over(edges, 4)
    params = Params(*(np.asarray(g, dtype) for g in gains))
    state, info = run(step, params, init(params), Imu(*readings, dt.astype(dtype)))
    matrices = np.array(
        [Rotation.from_quat(q, scalar_first=True).as_matrix() for q in np.asarray(info.quaternion, float)]
    )
    tolerance = 1e-11 if dtype == "float64" else 2e-4
    np.testing.assert_allclose(matrices, expected, atol=tolerance)
    used = sorted({i for edge in edges for i in edge})
    np.testing.assert_allclose(np.asarray(state.bias)[used], bias[used], atol=tolerance)


def moving(biases, seconds=60, hz=200):
    """Two IMUs on links that turn slowly about different axes: readings (T, 2, 3) and the relative rotation."""
    t = np.arange(seconds * hz) / hz
    first = Rotation.from_euler("ZYX", np.c_[0.8 * np.sin(0.5 * t), 0.6 * np.sin(0.7 * t), 0.7 * np.sin(0.9 * t)])
    joint = Rotation.from_rotvec(np.outer(1.2 * np.sin(0.8 * t), [1.0, 0, 0]))
    second = first * joint * Rotation.from_euler("Y", 0.3)
    readings = []
    for k, path in enumerate((first, second)):
        rate = (path[:-1].inv() * path[1:]).as_rotvec() * hz
        rate = np.vstack([rate[:1], rate]) + biases[k]
        readings.append((rate, path.inv().apply(UP), path.inv().apply(FIELD)))
    gyr, acc, mag = (np.stack(x, axis=1).astype("f") for x in zip(*readings, strict=True))
    dt = np.full(len(t), 1 / hz, "f")
    yes = np.ones(gyr.shape[:2], bool)
    return Imu(Reading(gyr, yes), Reading(acc, yes), Reading(mag, yes), dt), first.inv() * second


def test_each_imus_bias_is_found_and_the_rotation_follows():
    """Biases of both, constant in their own frames: one integral per pair could not hold them as the posture turns."""
    biases = np.array([[0.02, -0.01, 0.015], [-0.015, 0.02, 0.01]])
    measurements, truth = moving(biases, seconds=40, hz=1000)  # a sample is compared with the attitude one step earlier
    init, step = pair.over([(0, 1)], 2)
    params = Params(*(np.float32(x) for x in (2.0, 0.6, 1.0, 1.0)))
    state, info = run(step, params, init(params), measurements)
    error = (Rotation.from_quat(np.asarray(info.quaternion[:, 0]), scalar_first=True).inv() * truth).magnitude()
    assert np.rad2deg(error[-2000:].max()) < 0.3
    off = np.asarray(state.bias) - biases
    turned = np.asarray(truth[-1].inv().apply(off[0]))
    assert np.abs(off[1] - turned).max() < 4e-3  # what the relative rate shows, to a tenth of the biases


def test_without_magnetometers_the_rest_follows_the_gyroscopes(wild):
    measurements, truth = moving(np.zeros((2, 3)), seconds=20)
    init, step = pair.over([(0, 1)], 2)
    params = Params(*(np.float32(x) for x in (1.0, 0.0, 1.0, 1.0)))
    _, info = run(step, params, init(params), measurements._replace(magnetometer=None))
    found = Rotation.from_quat(np.asarray(info.quaternion[:, 0]), scalar_first=True)
    up = measurements.accelerometer.value[:, 1] / 9.81
    seen = found.apply(up)
    assert np.abs(seen - measurements.accelerometer.value[:, 0] / 9.81).max() < 5e-3
    turn = found * truth.inv()  # about the vertical, and constant
    axis = measurements.accelerometer.value[:, 0] / 9.81
    along = np.sum(turn.as_rotvec() * axis, axis=1)
    assert np.ptp(along[100:]) < 0.05


def test_bad_edges():
    with pytest.raises(InputError, match="expected two different IMUs, each 0 to 2"):
        pair.over([(0, 3)], 3)
    with pytest.raises(InputError, match="got none"):
        pair.over([], 3)
    with pytest.raises(InputError, match="expected one for each of 3 IMUs"):
        pair.tree(3, [-1, 0])
    assert pair.tree(4, [-1, 0, 1, 0]) == ((0, 1), (1, 2), (0, 3))
    init, step = pair.over([(0, 1)], 2)
    params = Params()
    one = Reading(np.zeros((3, 3)), np.ones(3, bool))
    with pytest.raises(ValueError, match=r"measurement.gyroscope: got shape \(3, 3\), expected \(2, 3\)"):
        step(params, init(params), Imu(one, one, None, 0.01))
    assert len(jax.tree.leaves(init(params))) == 5
