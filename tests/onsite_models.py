"""Filters for pairs of IMUs as systems for the contract test: each with data of its own kind."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.filters import bingham_linear, rls
from jaxest.filters import savitzky_golay as sg
from jaxest.manifolds import quaternion as quat
from jaxest.simulate import manipulator
from jaxest.systems import onsite, onsite_chain
from jaxest.types import Reading, System


def window():
    """Two channels at uneven steps."""
    params = sg.Params(0.4)

    def simulate(params, *, key, steps):
        a, b = jax.random.split(key)
        dtype = jnp.asarray(params.shift).dtype
        signal = jax.random.normal(a, (steps, 2), dtype)
        dt = jax.random.uniform(b, (steps,), dtype, 0.8, 1.2)
        return sg.Sample(Reading(signal, jnp.ones(steps, bool)), dt), None

    init = partial(sg.init, half_width=2, channels=2)
    return System(params, init, partial(sg.step, degree=2), simulate)


def rotation(information=None):
    """Pairs of rates with a bias between them."""

    def simulate(params, *, key, steps):
        keys = jax.random.split(key, 4)
        dtype = jnp.asarray(params.bias).dtype
        q = quat.normalize(jax.random.normal(keys[0], (4,), dtype))
        b = jax.random.normal(keys[1], (steps, 3), dtype)
        a = jax.vmap(lambda x: quat.rotate(q, x))(b) + 0.1
        noise = 0.05 * jax.random.normal(keys[2], (2, steps, 3), dtype)
        there = jnp.ones(steps, bool)
        pair = bingham_linear.Pair(Reading(a + noise[0], there), Reading(b + noise[1], there), jnp.zeros(steps, dtype))
        return pair, q

    noise = 0.05**2 * np.eye(3)
    params = bingham_linear.Params(noise, noise, forgetting=0.98)
    return System(params, bingham_linear.init, partial(bingham_linear.step, information=information), simulate)


def position(start=rls.patient):
    """Three equations a step for three unknowns, regressors noisy."""

    def simulate(params, *, key, steps):
        keys = jax.random.split(key)
        dtype = jnp.asarray(params.forgetting).dtype
        o = 0.3 * jax.random.normal(keys[0], (steps, 3, 3), dtype)
        x = jnp.asarray([[[1.0, -0.5, 1.5]]], dtype)
        y = jnp.sum(o * x, axis=2) + jax.random.normal(keys[1], (steps, 3), dtype)
        there = jnp.ones(steps, bool)
        noise = jnp.broadcast_to(0.01 * jnp.eye(3, dtype=dtype)[None], o.shape)
        return rls.Observation(Reading(o, there), Reading(y, there), noise, jnp.zeros(steps, dtype)), None

    params = rls.Params(forgetting=0.98, prior=2.0, floor=0.5)
    init = partial(rls.init, lag=4)
    return System(params, init, partial(rls.step, block=1, start=start), simulate)


def pose():
    """The live system with a short window, on a motion quick enough to tell something in twelve steps."""
    system = onsite.build(half_width=2, degree=2, lag=4)
    params = system.default_params._replace(
        gyroscope_noise=0.1,
        gate=1.0,
        forgetting_rotation=0.98,
        forgetting_position=0.97,
        bias_a=np.full(3, 0.01),
        gyroscope_axes=0.01,
        accelerometer_axes=0.02,
        accelerometer_bias=0.05,
    )
    options = {"rate_hz": 8.0, "speed": 1.0, "length": 1.0, "shaking": 0.1, "gyroscope": 0.03, "accelerometer": 0.1}
    return system._replace(default_params=params, simulate=partial(system.simulate, **options))


def chain():
    """Two links between three modules, with the window and the motion of `pose`."""
    system = onsite_chain.build(manipulator.draw(0).assembly, half_width=2, degree=2, lag=4)
    given = pose()
    pair = given.default_params._replace(gyroscope_axes=0.01, accelerometer_axes=0.01)
    options = given.simulate.keywords
    params = system.default_params._replace(pair=pair, position_limit=1.0, rotation_limit=1.0, hold=0.3)
    return system._replace(default_params=params, simulate=partial(system.simulate, **options))
