import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxest.viz.orientation import angles, claimed_deg, draw

RNG = np.random.default_rng(4)


def wxyz(rotation):
    return np.roll(rotation.as_quat(), 1, axis=-1)


def test_angles_are_those_of_scipy():
    rotation = Rotation.random(200, random_state=1)
    heading, pitch, roll = rotation.as_euler("ZYX", degrees=True).T
    np.testing.assert_allclose(angles(wxyz(rotation)).value, np.stack([roll, pitch, heading], -1), atol=1e-9)


def test_deviations_of_angles_agree_with_sampling():
    rotation = Rotation.from_euler("ZYX", [0.4, 0.7, -1.1])
    root = RNG.normal(size=(3, 3)) * 4e-3
    n = 20000
    draws = rotation * Rotation.from_rotvec(RNG.normal(size=(n, 3)) @ root.T)
    sd = angles(wxyz(rotation)[None], (root @ root.T)[None]).sd[0]
    sampled = angles(wxyz(draws)).value.std(axis=0)
    np.testing.assert_allclose(sd, sampled, rtol=5 / np.sqrt(2 * n))  # five standard errors of a standard deviation


def test_claimed_bounds_hold_95_percent():
    from jaxest.metrics import orientation_error

    rotation = Rotation.from_euler("ZYX", [0.4, 0.7, -1.1])
    to_sensor = rotation.inv().as_matrix()
    covariance = to_sensor @ np.diag([2e-3, 2e-3, 9e-3]) ** 2 @ to_sensor.T  # round about the vertical
    n = 20000
    noise = RNG.multivariate_normal(np.zeros(3), covariance, n)
    error = orientation_error(wxyz(rotation * Rotation.from_rotvec(noise)), np.tile(wxyz(rotation), (n, 1)))
    heading, inclination = claimed_deg(wxyz(rotation)[None], covariance[None])
    for value, bound in ((error.heading, heading), (error.inclination, inclination)):
        inside = np.mean(np.rad2deg(value) <= bound)
        assert inside == pytest.approx(0.95, abs=5 * np.sqrt(0.95 * 0.05 / n))


@pytest.mark.parametrize("full", [True, False])
def test_picture_is_written(tmp_path, full):
    n = 50
    truth = wxyz(Rotation.from_euler("Z", np.linspace(170, 200, n)[:, None], degrees=True))  # wraps around
    more = {}
    if full:
        hidden = truth.copy()
        hidden[:5] = np.nan
        more = {"covariance": np.tile(np.eye(3) * 1e-4, (n, 1, 1)), "truth": hidden, "movement": np.arange(n) > 9}
    draw(tmp_path / "a.png", np.arange(n) * 0.1, truth, **more, heading=full, title="x")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
