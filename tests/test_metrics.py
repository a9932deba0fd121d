"""Metrics against SciPy's rotations and chi-square, in NumPy and in JAX."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from jaxest import metrics


@pytest.fixture(params=[np.asarray, jnp.asarray], ids=["numpy", "jax"])
def array(request):
    with jax.enable_x64(True):
        yield request.param


def pair(n=200, seed=0):
    random = np.random.default_rng(seed)
    return Rotation.random(n, rng=random), Rotation.random(n, rng=random)


def wxyz(rotation):
    return rotation.as_quat(scalar_first=True)


def test_orientation_errors_are_those_of_broad(array):
    estimate, truth = pair()
    w, _, _, z = wxyz(estimate * truth.inv()).T
    error = metrics.orientation_error(array(wxyz(estimate)), array(-wxyz(truth)))
    np.testing.assert_allclose(error.total, 2 * np.arccos(np.abs(w)), atol=1e-12)
    np.testing.assert_allclose(error.heading, 2 * np.arctan(np.abs(z / w)), atol=1e-12)
    np.testing.assert_allclose(error.inclination, 2 * np.arccos(np.sqrt(w * w + z * z)), atol=1e-12)
    assert isinstance(error.total, np.ndarray) == (array is np.asarray)


@pytest.mark.parametrize("angle", [1e-7, 1e-3, 1.0, 3.0])
def test_a_turn_about_the_vertical_is_heading_alone(angle):
    """Also in float32, where acos would lose angles below 3e-4."""
    truth = pair()[0]
    for axis, heading, inclination in (([0, 0, 1], angle, 0.0), ([0.6, 0.8, 0], 0.0, angle)):
        estimate = wxyz(Rotation.from_rotvec(angle * np.array(axis)) * truth)
        error = metrics.orientation_error(estimate, wxyz(truth))
        np.testing.assert_allclose([error.heading.max(), error.inclination.max()], [heading, inclination], atol=1e-9)
        small = metrics.orientation_error(estimate.astype(np.float32), wxyz(truth).astype(np.float32))
        assert small.total.dtype == np.float32
        np.testing.assert_allclose(small.total, angle, atol=5e-7)


def test_the_difference_leads_from_the_estimate_to_the_truth(array):
    estimate, truth = pair()
    difference = metrics.orientation_difference(array(wxyz(estimate)), array(-wxyz(truth)))
    np.testing.assert_allclose(difference, (estimate.inv() * truth).as_rotvec(), atol=1e-12)
    near = wxyz(estimate * Rotation.from_rotvec(np.full((200, 3), 1e-8)))
    np.testing.assert_allclose(metrics.orientation_difference(array(wxyz(estimate)), array(near)), 1e-8, atol=1e-15)


def test_gradients_are_finite_where_the_error_is_zero():
    q = jnp.array([0.5, 0.5, 0.5, 0.5])

    def total(p):
        return sum(metrics.orientation_error(p, q)) + jnp.sum(metrics.orientation_difference(p, q))

    assert np.all(np.isfinite(jax.grad(total)(q)))
    assert np.all(np.isfinite(jax.grad(lambda p: metrics.position_error(p, jnp.ones(3)))(jnp.ones(3))))
    some = jnp.array([[True, True], [True, False], [False, False]])

    def rms(error):
        found = metrics.rmse(error, some)
        return metrics.rmse(error[0]) + found[0] + found[1]

    np.testing.assert_allclose(jax.grad(rms)(jnp.array([[0.0, 0], [2, jnp.nan], [1, 1]])), [[0, 0], [1, 0], [0, 0]])


def test_headings_are_aligned_at_one_sample(array):
    estimate, truth = pair()
    aligned = metrics.align_heading(array(wxyz(estimate)), array(wxyz(truth)), sample=7)
    error = metrics.orientation_error(array(wxyz(estimate)), aligned)
    before = metrics.orientation_error(array(wxyz(estimate)), array(wxyz(truth)))
    assert error.heading[7] < 1e-7
    np.testing.assert_allclose(error.inclination, before.inclination, atol=1e-12)
    turn = Rotation.from_quat(np.asarray(aligned), scalar_first=True) * truth.inv()
    np.testing.assert_allclose(turn.as_rotvec(), turn[0].as_rotvec()[None].repeat(200, axis=0), atol=1e-10)


def test_circular_and_position_errors(array):
    wrapped = metrics.circular_error(array([3.0, -3.0, 0.5]), array([-3.0, 3.0, 0.2]))
    np.testing.assert_allclose(wrapped, [6 - 2 * np.pi, 2 * np.pi - 6, 0.3])
    assert metrics.circular_error(array(np.pi), array(0.0)) == -np.pi
    distance = metrics.position_error(array([[1.0, 2, 3], [0, 0, 0]]), array([[1.0, 2, 3], [3, 4, 0]]))
    np.testing.assert_allclose(distance, [0, 5])


def test_rmse_counts_what_it_is_told_to(array):
    error = array([[3.0, np.nan, 4.0, 100.0], [1.0, 1.0, 1.0, 1.0]])
    where = array([[True, False, True, False], [False, False, False, False]])
    result = np.asarray(metrics.rmse(error, where))
    np.testing.assert_allclose(result[0], np.sqrt(12.5))
    assert np.isnan(result[1])
    np.testing.assert_allclose(metrics.rmse(error[1]), 1.0)


def test_the_broad_metric_leaves_out_rest_and_occlusion(array):
    truth = wxyz(pair()[0])
    off = wxyz(Rotation.from_rotvec([0, 0, np.radians(3)]) * Rotation.from_quat(truth, scalar_first=True))
    off[:50], truth[50:60] = wxyz(pair(seed=5)[1])[:50], np.nan
    movement = np.arange(200) >= 50
    error = metrics.broad_rmse_deg(array(off), array(truth), array(movement))
    np.testing.assert_allclose([float(e) for e in error], [3, 3, 0], atol=1e-6)
    wider = metrics.broad_rmse_deg(array(off), array(truth), array(movement | True))
    assert wider.total > 10


def test_the_broad_metric_takes_plain_lists():
    error = metrics.broad_rmse_deg([[1.0, 0, 0, 0]], [[0.0, 1, 0, 0]], [True])
    np.testing.assert_allclose(error, [180, 0, 180])


def test_coverage(array):
    truth, lower, upper = array([1.0, 2, 3, 4]), array([0.0, 2, 4, 0]), array([2.0, 2, 5, 1])
    assert metrics.coverage(truth, lower, upper) == 0.5
    np.testing.assert_allclose(metrics.coverage(truth, lower, upper, array([True, True, True, False])), 2 / 3)
    assert np.isnan(metrics.coverage(truth, lower, upper, array([False] * 4)))


def test_nees_is_chi_square_and_its_bounds_are_those(array):
    random = np.random.default_rng(3)
    root = random.normal(size=(4000, 3, 3))
    covariance = root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(3)
    error = (np.linalg.cholesky(covariance) @ random.normal(size=(4000, 3, 1)))[..., 0]
    values = np.asarray(metrics.nees(array(error), array(covariance)))
    np.testing.assert_allclose(values[0], error[0] @ np.linalg.inv(covariance[0]) @ error[0])
    lower, upper = metrics.nees_bounds(3, 4000, 0.999)
    assert lower < values.mean() < upper
    assert not lower < 1.2 * values.mean() < upper
    expected = np.array(stats.chi2.interval(0.95, 60)) / 20
    np.testing.assert_allclose(metrics.nees_bounds(3, 20), expected, rtol=1e-10)


def test_wrong_arguments_are_named():
    with pytest.raises(ValueError, match=r"truth: got shape \(3,\), expected \(..., 4\)"):
        metrics.orientation_error(np.zeros(4), np.zeros(3))
    with pytest.raises(ValueError, match=r"covariance: got shape \(3,\), expected \(..., 3, 3\)"):
        metrics.nees(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="probability 1"):
        metrics.nees_bounds(3, 10, 1)


def test_numpy_arrays_start_no_backend():
    code = (
        "import numpy as np; from jaxest import metrics; from jax._src import xla_bridge\n"
        "q = np.tile([1.0, 0, 0, 0], (5, 1))\n"
        "metrics.broad_rmse_deg(q, q, np.ones(5, bool)), metrics.nees(np.ones(3), np.eye(3))\n"
        "metrics.align_heading(q, q), metrics.circular_error(q, q), metrics.coverage(q, q, q)\n"
        "assert not xla_bridge.backends_are_initialized()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
