"""Ellipsoids, rests and clocks: known truths, repeated draws, and what must be refused."""

import numpy as np
import pytest

from jaxest.calibration import clock, ellipsoid, imu_static
from jaxest.types import InputError

G = 9.80665


def sensor(random, noise=0.05, count=400, cap=1.0):
    """Gain matrix, bias and readings; directions with z above `1 - 2 cap` only, any way up."""
    gain = np.eye(3) + 0.05 * random.normal(size=(3, 3))
    gain = np.linalg.cholesky(gain @ gain.T)
    symmetric = np.linalg.svd(gain)
    gain = symmetric[0] @ np.diag(symmetric[1]) @ symmetric[0].T
    bias = 0.3 * random.normal(size=3)
    z = random.uniform(1 - 2 * cap, 1, count)
    angle = random.uniform(0, 2 * np.pi, count)
    u = np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return gain, bias, G * (u @ turn.T) @ gain.T + bias + noise * random.normal(size=(count, 3))


def test_a_thousand_ellipsoids():
    """Partial coverage down to a third of the sphere: within 4 standard errors or refused, and as probable as said."""
    random = np.random.default_rng(0)
    nees, refused = [], 0
    for _ in range(1000):
        gain, bias, y = sensor(random, random.uniform(0.01, 0.1), cap=random.uniform(0.33, 1.0))
        try:
            found = ellipsoid.fit(y)
        except InputError:
            refused += 1
            continue
        assert np.linalg.eigvalsh(found.matrix)[0] > 0
        axes = np.linalg.eigvalsh(gain)
        error = np.linalg.inv(gain) - found.matrix
        x = np.concatenate([[error[i, j] for i, j in ellipsoid.ENTRIES], bias - found.bias])
        nees.append(x @ np.linalg.solve(found.covariance, x))
        # Of 6000 normal errors 0.4 are expected beyond 4 standard errors.
        assert np.all(np.abs(found.axes - axes) < 4 * found.axes_error)
        assert np.all(np.abs(found.bias - bias) < 4 * np.sqrt(np.diag(found.covariance)[6:]))
    assert refused < 300
    assert abs(np.mean(nees) - 9) < 6 * np.sqrt(18 / len(nees))


def test_too_few_directions_are_refused():
    random = np.random.default_rng(1)
    circle = np.linspace(0, 2 * np.pi, 300)
    flat = G * np.column_stack([np.cos(circle), np.sin(circle), 0 * circle]) + 0.02 * random.normal(size=(300, 3))
    for y in (flat, sensor(random, cap=0.02)[2], np.tile([0, 0, G], (50, 1)) + 0.02 * random.normal(size=(50, 3))):
        with pytest.raises(InputError, match="do not determine"):
            ellipsoid.fit(y)
    with pytest.raises(InputError, match="at least 12"):
        ellipsoid.fit(flat[:5])
    flat[7, 1] = np.nan
    with pytest.raises(InputError, match="row 7 is not finite"):
        ellipsoid.fit(flat)


def test_corrected_readings_have_the_right_length():
    _, _, y = sensor(np.random.default_rng(3), noise=0.0)
    found = ellipsoid.fit(y)
    np.testing.assert_allclose(np.linalg.norm(ellipsoid.apply(found, y), axis=1), G, rtol=1e-6)


def motion(random, time):
    f, phase = random.uniform(0.5, 1.5, (4, 3)), random.uniform(0, 6, (4, 3))
    return np.sin(2 * np.pi * f * time[:, None, None] + phase).sum(axis=1) / np.sqrt(2)


def test_a_rest_is_found():
    random = np.random.default_rng(0)
    time = np.arange(3000) / 100
    w = motion(random, time) * np.where((time > 12) & (time < 20), 0, 1)[:, None]
    f = 3 * motion(random, time) * np.where((time > 12) & (time < 20), 0, 1)[:, None] + [0, 0, G]
    bias = np.array([0.1, -0.2, 0.05])
    w, f = w + bias + 0.01 * random.normal(size=w.shape), f + 0.05 * random.normal(size=f.shape)
    rest = imu_static.calibrate(time, w, f)
    assert 1200 <= rest.start < 1260
    assert 1940 < rest.stop <= 2001
    np.testing.assert_allclose(rest.gyroscope_bias, bias, atol=4 * 0.01 / np.sqrt(700))
    np.testing.assert_allclose(np.diag(rest.gyroscope_covariance), 1e-4, rtol=4 * np.sqrt(2 / 700))
    np.testing.assert_allclose(np.diag(rest.accelerometer_covariance), 25e-4, rtol=4 * np.sqrt(2 / 700))
    # The derivative's gain for N = 7, M = 3 at 100 Hz, by SciPy's coefficients; windows overlap.
    from scipy.signal import savgol_coeffs

    gain = np.sum(savgol_coeffs(15, 3, deriv=1, delta=0.01) ** 2)
    np.testing.assert_allclose(np.diag(rest.turn_covariance), 1e-4 * gain, rtol=0.5)
    with pytest.raises(InputError, match="never rests"):
        imu_static.calibrate(time[:1000], w[:1000], f[:1000])


@pytest.mark.parametrize(("hz", "noise", "step"),
                         [(10, 3e-3, 0), (25, 3e-3, 0), (50, 2e-4, 1.1e-3), (100, 2e-4, 1.1e-3)])  # fmt: skip
def test_a_rest_stays_in_one_piece(hz, noise, step):
    """Few rows a window, or a converter's steps coarser than the noise, whose covariance they are then."""
    random = np.random.default_rng(0)
    time = np.arange(60 * hz) / hz
    w, f = 0.01 + noise * random.normal(size=(len(time), 3)), [0, 0, G] + 0.02 * random.normal(size=(len(time), 3))
    w = np.round(w / step) * step if step else w
    assert imu_static.rests(time, w, f) == (slice(0, len(time)),)
    rest = imu_static.calibrate(time, w, f)
    deviation = np.sqrt(np.diag(rest.gyroscope_covariance))
    if step:
        np.testing.assert_allclose(deviation, step / np.sqrt(12), rtol=0.2)
        assert np.linalg.eigvalsh(rest.turn_covariance)[0] > 0
    else:
        np.testing.assert_allclose(deviation, noise, rtol=4 / np.sqrt(2 * len(time)))


@pytest.mark.recorded
def test_the_recorded_rod_rests_first(shared):
    a = np.load(shared / "recordings" / "two_imus_200mm" / "twoimus_200mm_sample.npz")["imu0"]
    rest = imu_static.calibrate(a[:, 0], a[:, 2:5], a[:, 5:8])
    assert rest.start < 10
    assert 40 < rest.stop < 75
    np.testing.assert_allclose(rest.gyroscope_bias, a[:55, 2:5].mean(axis=0), atol=0.01)


def test_clocks():
    """30 pairs: offsets within what is said, and a drift is seen."""
    random = np.random.default_rng(4)
    errors = []
    for _ in range(30):
        ta = np.arange(1500) / 100 + random.uniform(-0.002, 0.002, 1500)
        tp = np.arange(1500) / 100 + 0.004 + random.uniform(-0.002, 0.002, 1500)
        seed, late = int(random.integers(1 << 30)), random.uniform(-0.2, 0.2)
        turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        wa = motion(np.random.default_rng(seed), ta) + 0.02 * random.normal(size=(1500, 3))
        wp = motion(np.random.default_rng(seed), tp) @ turn + 0.1 + 0.02 * random.normal(size=(1500, 3))
        found = clock.offset(ta, wa, tp + late, wp)
        errors.append((found.seconds - late) / found.deviation)
        assert abs(found.seconds - late) < 1e-3
        assert abs(found.drift) < 5 * found.drift_deviation
    assert abs(np.mean(np.square(errors)) - 1) < 4 * np.sqrt(2 / 30)
    drifting = clock.offset(ta, wa, tp + late + 1e-3 * tp, wp)
    assert drifting.drift > 3 * drifting.drift_deviation
    with pytest.raises(InputError, match="overlap"):
        clock.offset(ta, wa, tp + 100, wp)
    with pytest.raises(InputError, match="hardly vary"):
        clock.offset(ta, 0 * wa, tp, wp)
    with pytest.raises(InputError, match="rate_p: row 9 is not finite"):
        clock.offset(ta, wa, tp, np.where(np.arange(1500)[:, None] == 9, np.nan, wp))
    with pytest.raises(InputError, match=r"time_a, rate_a: got \(0,\), \(1500, 3\), expected"):
        clock.offset([], wa, tp, wp)


@pytest.mark.parametrize("side", [0, 1])
def test_clocks_are_not_compared_where_a_recording_has_a_gap(side):
    random = np.random.default_rng(6)
    time = np.arange(1500) / 100
    rate = motion(random, time)
    kept = (time < 5) | (time > 8)
    stamps, rates = ([x, x] for x in (time, rate))
    stamps[side], rates[side] = time[kept], rate[kept]
    whole = (r + 0.02 * random.normal(size=r.shape) for r in rates)
    found = clock.offset(stamps[0], next(whole), stamps[1] + 0.05, next(whole))
    assert abs(found.seconds - 0.05) < 5 * found.deviation
    assert found.deviation < 1e-3
    assert found.residual < 0.03
    sparse = np.sort(random.uniform(0, 15, 4)) + np.arange(400)[:, None] / 1000
    with pytest.raises(InputError, match=r"overlap by \d.\d s outside of their gaps, expected more than 2 s"):
        clock.offset(time, rate, np.unique(sparse), np.zeros((len(np.unique(sparse)), 3)))
