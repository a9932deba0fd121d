"""Derivatives of compiled batches: those of one item after the other, wherever the batch axis stands.

JAX (0.10) transposes them silently where a custom rule and its function put the axis in different places.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK

from jaxest import kinematics, models
from jaxest.distributions import _bingham_normalizer as bingham
from jaxest.filters.kalman import _square_root
from jaxest.filters.particle import proposal
from jaxest.linalg import _eigen4
from jaxest.manifolds import quaternion

N = 3
# What is tested are JAX's rules; the compiler's effort would be most of the time.
quick = partial(jax.jit, compiler_options=QUICK)
ARM = kinematics.load(models.path("arm"))
ROVER = kinematics.load(models.path("rover"))


def spd(a):
    return a @ a.T + jnp.diag(jnp.arange(1.0, len(a) + 1))


def arm_frames(frames, offset, q):
    robot = kinematics.with_parameters(ARM, position={"link3": offset})
    return kinematics.forward(robot, q, frames)


def arm_jacobian(offset, q):
    return kinematics.jacobian(kinematics.with_parameters(ARM, position={"link3": offset}), q, "hand")


def arm_acceleration(mass, q):
    return kinematics.forward_dynamics(kinematics.with_parameters(ARM, mass={"hand": mass}), q, 0 * q, 0 * q)


CASES = {
    "forward, a site": (partial(arm_frames, ["site:end_effector"]), (3,), (4,)),
    "forward, two": (partial(arm_frames, ["site:imu2", "hand"]), (3,), (4,)),
    "forward, all": (partial(arm_frames, None), (3,), (4,)),
    "forward, rover": (lambda g, q: kinematics.forward(ROVER, q + g[0]).position, (1,), (ROVER.nq,)),
    "jacobian": (arm_jacobian, (3,), (4,)),
    "gravity_torque": (lambda g, q: kinematics.gravity_torque(ARM, q * g), (), (4,)),
    "forward_dynamics": (arm_acceleration, (), (4,)),
    "eigen4": (lambda s, a: _eigen4.eigen4(s * (a + a.T)), (), (4, 4)),
    "root": (lambda s, a: _square_root.root(s * spd(a)), (), (3, 3)),
    "triangular": (lambda s, a: _square_root.triangular(s * a), (), (3, 5)),
    "mean": (lambda s, x: quaternion.mean(jax.vmap(quaternion.normalize)(x + s)), (), (5, 4)),
    "second_moments": (lambda s, x: bingham.second_moments(s * x), (), (4,)),
    "matrix_second_moment": (lambda s, a: bingham.matrix_second_moment(s * (a + a.T)), (), (4, 4)),
    "matrix_log_prob": (lambda s, a: bingham.matrix_log_prob(a[0] / jnp.linalg.norm(a[0]), s * (a + a.T)), (), (4, 4)),
    "silent": (lambda s, x: x[0] + proposal._silent(lambda s, x: s * x, s, x), (), (3,)),
}  # fmt: skip


SLOW = ("forward, rover", "forward, a site", "forward, two", "forward_dynamics", "matrix_second_moment")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in CASES])
def test_derivatives_of_a_compiled_batch_are_those_of_its_items(name, x64):
    function, shared, own = CASES[name]
    random = np.random.default_rng(0)
    a, da = (jnp.asarray(random.normal(size=shared) + 1) for _ in range(2))
    x, dx = (jnp.asarray(random.normal(size=(N, *own))) for _ in range(2))
    batch = quick(jax.vmap(function, (None, 0)))
    last = quick(jax.vmap(function, (None, -1)))
    function = quick(function)
    expected_value = jax.tree.map(lambda *r: jnp.stack(r), *(function(a, row) for row in x))
    for pushed in ((da, 0 * dx), (0 * da, dx), (da, dx)):
        rows = [jax.jvp(function, (a, row), (pushed[0], moved))[1] for row, moved in zip(x, pushed[1], strict=True)]
        expected = jax.tree.map(lambda *r: jnp.stack(r), *rows)
        one = (lambda a: batch(a, x), (a,), pushed[:1])
        two = (lambda x: batch(a, x), (x,), pushed[1:])
        both = (batch, (a, x), pushed)
        calls = [both] + ([one] if not pushed[1].any() else []) + ([two] if not pushed[0].any() else [])
        for call in calls:
            found = jax.jvp(*call)
            jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9), found, (expected_value, expected))
    moved = jax.jvp(last, (a, jnp.moveaxis(x, 0, -1)), (da, jnp.moveaxis(dx, 0, -1)))
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9), moved, (expected_value, expected))
