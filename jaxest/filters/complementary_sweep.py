"""Many settings of the complementary filter over many recordings at once, with no history: for choosing gains.

The same filter as `complementary.step` scanned with `last`, written for the vector units: time is the only loop, each
component of the state is an array over recordings and settings, what depends on the recording alone is worked out
before, and the rotation of a step is a short polynomial in place of sines. Samples at which a recording's first vectors
set its orientation go through `complementary.step` itself.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from jaxest.filters.complementary import Params, State, init, step
from jaxest.filters.imu import Imu, Sample, directed, usable
from jaxest.manifolds import _coefficients as coefficient
from jaxest.types import Array


@jax.jit
def sweep(params: Params, measurements: Imu) -> State:
    """Run s settings of the filter over b recordings and return where they end.

    Args:
        params: gains and weights, each (s,) or ().
        measurements: leaves (b, T, ...), as `complementary.step` takes them; pad unequal lengths with samples that are
            not valid and take no time.

    Returns:
        The final states, leaves (b, s, ...). Float32 and exact to rounding for steps of up to a whole turn.

    Raises:
        ValueError: a shape is wrong.
    """
    given = [jnp.asarray(x) for x in params]
    dtype = jnp.result_type(*(x.dtype for x in given), float(0))
    settings = jnp.broadcast_shapes(*(x.shape for x in given), (1,))
    gains = Params._make([jnp.broadcast_to(x.astype(dtype), settings) for x in given])
    batch, length = jnp.shape(measurements.dt)
    sample = jax.vmap(jax.vmap(lambda m: directed(usable(m, dtype))))(measurements)
    used = [x.valid for x in sample[:3]]
    levelled = jnp.cumsum(used[1], axis=1) > 0
    headed = jnp.cumsum(used[2] & levelled, axis=1) > 0
    before = [jnp.pad(x[:, :-1], ((0, 0), (1, 0))) for x in (levelled, headed)]
    begins = jnp.any((levelled & ~before[0]) | (headed & ~before[1]), axis=0)
    start = jax.vmap(lambda p: init(p))(gains)
    state = jax.tree.map(lambda x: jnp.broadcast_to(x[None], (batch, *x.shape)), start)
    rows = jax.tree.map(lambda x: jnp.moveaxis(x, 1, 0), (sample, before[0], before[1]))

    def body(carry: Any, row: Any) -> tuple[Any, None]:
        (sample, levelled, headed), now = row
        exact, fast = partial(_exact, gains, carry, sample), partial(_fast, gains, carry, sample)
        return jax.lax.cond(now, exact, partial(fast, levelled, headed)), None

    quaternion = tuple(state.quaternion[..., i] for i in range(4))
    carry = quaternion, tuple(state.bias[..., i] for i in range(3)), state.initialized, state.heading_initialized
    (quaternion, bias, initialized, heading), _ = jax.lax.scan(body, carry, (rows, begins))
    count = jnp.full((batch, settings[0]), length, jnp.int32)
    return State(jnp.stack(quaternion, -1), jnp.stack(bias, -1), count, initialized, heading)


def _exact(gains: Params, carry: Any, sample: Sample) -> Any:
    """The step itself, for samples that set an orientation."""
    q, b, initialized, headed = carry
    index = jnp.zeros(initialized.shape, jnp.int32)
    state = State(jnp.stack(q, -1), jnp.stack(b, -1), index, initialized, headed)
    every = jax.vmap(jax.vmap(lambda p, s, m: step(p, s, m)[0], (0, 0, None)), (None, 0, 0))
    after = every(gains, state, Imu(*sample[:3], sample.dt))
    parts = tuple(after.quaternion[..., i] for i in range(4)), tuple(after.bias[..., i] for i in range(3))
    return *parts, after.initialized, after.heading_initialized


def _fast(gains: Any, carry: Any, sample: Sample, levelled: Array, headed: Array) -> Any:
    """One sample by components: those of the recordings are (b, 1), of the gains (1, s)."""
    (w, x, y, z), (bx, by, bz), initialized, heading = carry
    dt = sample.dt[:, None]
    live = jnp.where(levelled, sample.dt, 0)[:, None] / 2
    (gx, gy, gz), (ax, ay, az), (mx, my, mz) = (
        tuple(jnp.where(flag, reading.value[:, i], 0)[:, None] for i in range(3))
        for reading, flag in zip(sample[:3], (sample.gyroscope.valid, levelled, levelled & headed), strict=True)
    )
    seen = sample.gyroscope.valid[:, None].astype(dt.dtype)
    k_p, k_i, weight_acc, weight_mag = (g[None] for g in gains)
    w2, x2, y2, z2 = 2 * w, 2 * x, 2 * y, 2 * z
    r00, r01, r02 = 1 - y2 * y - z2 * z, x2 * y - w2 * z, x2 * z + w2 * y
    r10, r11, r12 = x2 * y + w2 * z, 1 - x2 * x - z2 * z, y2 * z - w2 * x
    r20, r21, r22 = x2 * z - w2 * y, y2 * z + w2 * x, 1 - x2 * x - y2 * y
    hx, hy, hz = r00 * mx + r01 * my + r02 * mz, r10 * mx + r11 * my + r12 * mz, r20 * mx + r21 * my + r22 * mz
    north = jnp.sqrt(hx * hx + hy * hy)
    # The magnetic error in the earth frame, field x reference, and back into the sensor's.
    ux, uy, uz = (weight_mag * v for v in (hz * (hy - north), -hx * hz, hx * north))
    ex = weight_acc * (ay * r22 - az * r21) + r00 * ux + r10 * uy + r20 * uz
    ey = weight_acc * (az * r20 - ax * r22) + r01 * ux + r11 * uy + r21 * uz
    ez = weight_acc * (ax * r21 - ay * r20) + r02 * ux + r12 * uy + r22 * uz
    bx, by, bz = bx - k_i * dt * ex, by - k_i * dt * ey, bz - k_i * dt * ez
    vx, vy, vz = (live * (seen * (g - b) + k_p * e) for g, b, e in ((gx, bx, ex), (gy, by, ey), (gz, bz, ez)))
    c, s = _half_turn(vx * vx + vy * vy + vz * vz)
    vx, vy, vz = s * vx, s * vy, s * vz
    turned = (
        w * c - x * vx - y * vy - z * vz,
        w * vx + x * c + y * vz - z * vy,
        w * vy - x * vz + y * c + z * vx,
        w * vz + x * vy - y * vx + z * c,
    )
    # Newton's step to length 1, from a length that is off by rounding.
    unit = (3 - (turned[0] ** 2 + turned[1] ** 2 + turned[2] ** 2 + turned[3] ** 2)) / 2
    return tuple(t * unit for t in turned), (bx, by, bz), initialized, heading


def _half_turn(square: Array) -> tuple[Array, Array]:
    """Cosine and sine over angle of the half angle h, from h^2: Taylor at h / 2 and its double, good for |h| <= pi."""
    if square.dtype != jnp.float32:
        return coefficient.cos_half(4 * square), 2 * coefficient.sin_half(4 * square)
    t = square / 4
    c = 1 + t * (-1 / 2 + t * (1 / 24 + t * (-1 / 720 + t * (1 / 40320 - t / 3628800))))
    s = 1 + t * (-1 / 6 + t * (1 / 120 + t * (-1 / 5040 + t * (1 / 362880 - t / 39916800))))
    return 2 * c * c - 1, c * s


__all__ = ["sweep"]
