"""Savitzky-Golay fits against NumPy's least squares and SciPy's coefficients."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import FULL, QUICK
from scipy.signal import savgol_coeffs, savgol_filter

from jaxest.filters import run
from jaxest.filters import savitzky_golay as sg
from jaxest.types import OK, InputError, Reading


def fit(time, value, at, degree):
    """Value and derivative of the polynomial by float64 least squares in scaled time."""
    span = np.ptp(time)
    at = np.clip(at, time.min(), time.max())
    a = ((time - at) / span)[:, None] ** np.arange(degree + 1)
    c = np.linalg.lstsq(a, value, rcond=None)[0]
    return c[0], c[1] / span


def recording(seed=0, length=60, channels=4):
    random = np.random.default_rng(seed)
    time = np.cumsum(random.uniform(0.004, 0.02, length)) + 1e5
    value = np.sin(time[:, None] * random.uniform(1, 20, channels)) + 0.1 * random.normal(size=(length, channels))
    return time, value, random.random(length) > 0.2


@pytest.mark.parametrize(("half_width", "degree"), [(3, 5), (10, 3), (30, 5), (3, 0)])
def test_equal_steps_give_the_textbook_weights(half_width, degree, dtype):
    width, h = 2 * half_width + 1, 0.01
    time = jnp.asarray(h * np.arange(width), dtype)
    query = h * half_width
    found = jax.jit(partial(sg.weights, degree=degree), compiler_options=QUICK)(time, jnp.ones(width, bool), query)
    tolerance = 1e-12 if dtype == "float64" else 2e-5
    np.testing.assert_allclose(found.value, savgol_coeffs(width, degree, use="dot"), atol=tolerance)
    if degree > 0:
        slope = savgol_coeffs(width, degree, deriv=1, delta=h, use="dot")
        np.testing.assert_allclose(found.derivative, slope, atol=10 * tolerance * np.abs(slope).max())


@pytest.mark.parametrize(("half_width", "degree"), [(3, 5), (8, 3)])
def test_any_stamps_and_any_query(half_width, degree, dtype):
    time, value, there = recording()
    query = np.concatenate([time, np.random.default_rng(1).uniform(time[0] - 0.1, time[-1] + 0.1, 40)])
    value = np.where(there[:, None], value, np.nan).astype(dtype)
    got = sg.smooth(time, value, there, query, half_width=half_width, degree=degree)
    assert got.value.dtype == dtype
    rows, _ = sg.windows(time, query, half_width)
    enough = there[rows].sum(axis=1) > degree
    inside = (query >= time[rows[:, 0]]) & (query <= time[rows[:, -1]])
    np.testing.assert_array_equal(got.valid, enough & inside)
    assert not inside.all()
    used = 0
    for i in np.flatnonzero(enough):
        pick = rows[i][there[rows[i]]]
        expected = fit(time[pick], np.asarray(value, float)[pick], query[i], degree)
        if np.ptp(time[pick]) < 0.5 * np.ptp(time[rows[i]]):
            continue
        # The rounding of the samples times the weights, which grow where the query is at the end of the window.
        scale = (1e-11 if dtype == "float64" else 3e-6) * np.sqrt(got.value_gain[i] + 1)
        np.testing.assert_allclose(got.value[i], expected[0], atol=scale * 30)
        steep = scale * 30 * np.sqrt(got.derivative_gain[i])
        np.testing.assert_allclose(got.derivative[i], expected[1], atol=steep)
        used += 1
    assert used > 35


@pytest.mark.parametrize("length", [15, 33, 1024])
def test_an_even_recording_is_a_correlation(length, dtype):
    """The quick way for even stamps gives SciPy's numbers to the ends, and those of the fits of each window."""
    time, value = 1e4 + np.arange(length) / 200, np.cumsum(np.random.default_rng(2).normal(size=(length, 2)), axis=0)
    value = value.astype(dtype)
    got = jax.jit(partial(sg.smooth, time), compiler_options=FULL)(value)
    assert got.value.dtype == dtype
    assert np.all(got.valid)
    eps = float(np.finfo(dtype).eps) * np.abs(value).max()
    expected = savgol_filter(value.astype(float), 15, 3, axis=0)
    np.testing.assert_allclose(got.value, expected, rtol=0, atol=40 * eps)
    slope = savgol_filter(value.astype(float), 15, 3, deriv=1, delta=1 / 200, axis=0)
    # Stamps of 1e4 s are known to 2e-12 s, 4e-10 of a step.
    np.testing.assert_allclose(got.derivative, slope, rtol=0, atol=4000 * eps + 1e-9 * np.abs(slope).max())
    one_by_one = sg.smooth(time, value, query=time)
    for a, b in zip(got, one_by_one, strict=True):
        scale = np.abs(np.asarray(b, float)).max()
        np.testing.assert_allclose(a, b, rtol=0, atol=(1e-9 if dtype == "float64" else 3e-5) * scale)


def test_an_even_recording_has_gradients_and_spreads_what_is_not_finite(x64):
    time, value = np.arange(40) / 100, np.random.default_rng(3).normal(size=(40, 1))
    last = jax.grad(lambda value: sg.smooth(time, value, half_width=3, degree=2).value[-1, 0])(jnp.asarray(value))
    np.testing.assert_allclose(last[-7:, 0], savgol_coeffs(7, 2, pos=6, use="dot"), atol=1e-12)
    assert not np.any(last[:-7])
    broken = np.where(np.arange(40)[:, None] == 20, np.nan, value)
    lost = np.isnan(sg.smooth(time, broken, half_width=3, degree=2).value[:, 0])
    assert np.flatnonzero(lost).tolist() == list(range(17, 24))


def test_stamps_that_are_nearly_even_are_taken_as_they_are(x64):
    """A step of a thousandth of the spacing beside its place changes a derivative; the fit of each window sees it."""
    time, value = np.arange(60) / 100, np.arange(60.0)[:, None] ** 2
    time[30] += 1e-5
    got = sg.smooth(time, value, half_width=3, degree=3)
    expected = fit(time[27:34], value[27:34], time[30], 3)
    np.testing.assert_allclose(got.derivative[30], expected[1], rtol=1e-9)


def test_streaming_is_the_batch(dtype):
    time, value, there = recording(3)
    params = sg.Params(np.asarray(0.0, dtype))
    state = sg.init(params, half_width=4, channels=4)
    dt = np.diff(time, prepend=time[0]).astype(dtype)
    samples = sg.Sample(Reading(np.where(there[:, None], value, np.nan).astype(dtype), there), dt)
    state, info = run(partial(sg.step, degree=3), params, state, samples)
    whole = sg.smooth(time, value.astype(dtype), there, half_width=4, degree=3)
    ready = np.asarray(info.valid)
    assert ready.sum() > 40
    assert not ready[:8].any()
    lagged = np.arange(len(time))[ready] - 4
    eps = 40 if dtype == "float64" else 20
    for a, b in zip(info[:4], whole[:4], strict=True):
        b = np.asarray(b)[lagged]
        np.testing.assert_allclose(np.asarray(a)[ready], b, atol=eps * np.finfo(dtype).eps * 8 * np.abs(b).max())
    delays = (time[lagged + 4] - time[lagged]).astype(float)
    np.testing.assert_allclose(np.asarray(info.delay, float)[ready], delays, atol=1e-6)
    np.testing.assert_array_equal(info.status, OK)


def test_the_gain_is_the_variance(x64):
    """Of white noise of variance 1, through an uneven window with a hole: the sum of the squared weights."""
    time, _, _ = recording(5)
    there = np.ones(60, bool)
    there[[28, 33]] = False
    one_at_a_time = np.eye(60)  # a channel for each sample reads the weight of that sample
    got = sg.smooth(time, one_at_a_time, there, time[30:31] + 0.003, half_width=5, degree=3)
    assert not np.any(got.value[0, ~there])
    np.testing.assert_allclose(np.sum(got.value**2), got.value_gain[0], rtol=1e-10)
    np.testing.assert_allclose(np.sum(got.derivative**2), got.derivative_gain[0], rtol=1e-10)


def test_the_average_of_a_derivative(x64):
    """The average of the true derivative is the filter's derivative, for any signal, to the trapezoidal rule."""
    time = np.cumsum(np.random.default_rng(0).uniform(0.002, 0.004, 41))
    time[11] = time[10]  # a missing sample holds the one before
    there = np.ones(41, bool)
    there[11] = False
    w = jax.jit(partial(sg.weights, degree=3), compiler_options=QUICK)(time, there, time[20])
    mean = sg.averaging(jnp.asarray(time), w.derivative)
    np.testing.assert_allclose(mean.sum(), 1, rtol=1e-12)
    for f in (1.0, 5.0, 12.0):
        signal, slope = np.sin(2 * np.pi * f * time), 2 * np.pi * f * np.cos(2 * np.pi * f * time)
        through, averaged = np.dot(w.derivative, signal), np.dot(mean, slope)
        error = 2 * (2 * np.pi * f) ** 3 * 0.004**2 / 12  # of the rule
        assert abs(through - averaged) < error
    assert abs(through - slope[20]) > 5 * error  # while the derivative itself is off


def test_shift_and_clamp(x64):
    params = sg.Params(jnp.asarray(0.5))
    state = sg.init(params, half_width=2, channels=1)
    value = np.arange(8.0)[:, None] ** 2
    samples = sg.Sample(Reading(value, np.ones(8, bool)), np.full(8, 1.0))
    _, info = run(partial(sg.step, degree=2), params, state, samples)
    np.testing.assert_allclose(info.value[4:, 0], (np.arange(4, 8) - 1.5) ** 2, rtol=1e-12)
    np.testing.assert_allclose(info.derivative[4:, 0], 2 * (np.arange(4, 8) - 1.5), rtol=1e-12)
    np.testing.assert_allclose(info.delay[4:], 1.5)
    _, info = run(partial(sg.step, degree=2), sg.Params(jnp.asarray(9.0)), state, samples)
    np.testing.assert_allclose(info.value[4:, 0], np.arange(4, 8) ** 2, rtol=1e-12)
    np.testing.assert_allclose(info.delay[4:], 0, atol=1e-12)


def test_gradients_are_finite_with_holes(x64):
    time, value, there = recording(2)

    def total(value):
        got = sg.smooth(time, value, there, half_width=4, degree=3)
        return jnp.sum(jnp.sin(got.value)) + jnp.sum(jnp.sin(got.derivative))

    slope = jax.grad(total)(jnp.where(there[:, None], value, jnp.nan))
    assert np.isfinite(slope).all()
    assert np.all(np.asarray(slope)[~there] == 0)


def test_bad_input():
    time, value, _ = recording()
    with pytest.raises(InputError, match="got 5 samples, expected at least 15"):
        sg.smooth(time[:5], value[:5])
    swapped = time.copy()
    swapped[[7, 8]] = swapped[[8, 7]]
    with pytest.raises(InputError, match="row 8 is"):
        sg.smooth(swapped, value)
    with pytest.raises(ValueError, match="degree: got 15, expected 0 to 14"):
        sg.smooth(time, value, degree=15)
    with pytest.raises(ValueError, match="half_width: got 0"):
        sg.init(sg.Params(), half_width=0)
    with pytest.raises(ValueError, match=r"expected \(3,\)"):
        sg.step(sg.Params(), sg.init(sg.Params()), sg.Sample(Reading(np.zeros(4), np.True_), 0.1))
