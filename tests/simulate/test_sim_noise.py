import jax
import jax.numpy as jnp
import numpy as np

from jaxest.simulate.noise import coloured


def test_coloured_noise_has_unit_variance_from_the_first_sample_on_and_its_correlation():
    runs, steps, time, dt = 20_000, 6, 0.05, 0.01
    drawn = jax.vmap(lambda key: coloured(key, steps, 1, dt, time, jnp.float32))(
        jax.random.split(jax.random.key(3), runs)
    )
    x = np.asarray(drawn[..., 0], float)
    # The sampling error of a mean square of normals is sqrt(2 / runs), that of a mean of products at most the same.
    error = np.sqrt(2 / runs)
    np.testing.assert_allclose(np.mean(x * x, 0), 1, atol=4 * error)
    lags = np.arange(steps)
    np.testing.assert_allclose(np.mean(x[:, :1] * x, 0), np.exp(-lags * dt / time), atol=4 * error)


def test_coloured_noise_of_one_sample_is_a_draw():
    assert coloured(jax.random.key(0), 1, 3, 0.01, 1.0, jnp.float32).shape == (1, 3)
