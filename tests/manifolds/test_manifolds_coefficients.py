"""The scalar functions of t^2 against their closed forms at 150 digits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import FULL
from reference import ref_manifolds as reference

from jaxest.manifolds import _coefficients as coefficients

WITHIN = np.geomspace(1e-9, np.pi, 60)
BEYOND = np.array([3.16, 3.17, 3.5, 4.0, 5.0, 5.5, 6.0])


NAMES = list(reference.CLOSED_FORMS)
ZERO = {
    "cos_half": (1, -1 / 8),
    "sin_half": (1 / 2, -1 / 48),
    "one_minus_cos": (1 / 2, -1 / 24),
    "t_minus_sin": (1 / 6, -1 / 120),
    "inverse_jacobian": (1 / 12, 1 / 720),
}
LIMITS = np.array([ZERO[name] for name in NAMES])


def orders(s):
    """Value, first and second derivative of all functions, (functions, 3)."""
    functions = [getattr(coefficients, name) for name in NAMES]
    return jnp.stack([jnp.stack([f(s), jax.grad(f)(s), jax.grad(jax.grad(f))(s)]) for f in functions])


def test_value_and_two_derivatives_to_a_few_eps(dtype):
    s = (np.concatenate([WITHIN, BEYOND, [0]]) ** 2).astype(dtype)
    exact = np.array([[reference.coefficient(name, float(x)) for name in NAMES] for x in s[:-1]])
    got = jax.jit(jax.vmap(orders), compiler_options=FULL)(s)
    assert got.dtype == dtype
    assert np.isfinite(got).all()
    got, at_zero = got[:-1], np.asarray(got[-1], np.float64)
    assert at_zero[:, :2] == pytest.approx(LIMITS, rel=4 * float(np.finfo(dtype).eps))
    error = np.abs(np.asarray(got, np.float64) - exact) / np.finfo(dtype).eps
    half_turn, beyond = slice(0, len(WITHIN)), slice(len(WITHIN), None)
    # In eps of the largest value, for cos_half passes zero. A value has the roundings of its last Horner steps; the
    # terms of a derivative alternate, at t = pi to twice their sum; inverse_jacobian is a quotient of two series.
    largest = np.abs(exact[half_turn]).max(axis=0)
    assert (error[half_turn] / largest).max(axis=0) == pytest.approx(0, abs=7)
    # In eps of the value itself, which the derivatives of the others never approach zero with.
    relative = (error / np.abs(exact))[:, 1:]
    assert relative[half_turn, :, 0].max() < 1.5
    assert relative[half_turn, :, 1].max() < 5
    assert relative[half_turn, :, 2].max() < 12
    # Beyond half a turn the closed forms divide by t^2 once more in each derivative, or by sin(t/2).
    assert relative[beyond].max() < 15


def test_arctan_ratio(dtype):
    y = np.concatenate([np.geomspace(1e-9, np.tan(np.pi / 16), 60)])
    r = (y**2).astype(dtype)
    root = np.sqrt(r.astype(np.longdouble))
    got = np.asarray(jax.jit(jax.vmap(coefficients.arctan_ratio), compiler_options=FULL)(r))
    assert np.abs(got - np.arctan(root) / root).max() < 1 * np.finfo(dtype).eps
