"""Probability densities of angles, rotations, vectors and covariances, accurate in float32 and float64.

An angle: `von_mises`; a rotation: `bingham` (unit quaternions wxyz); a vector: `gaussian`; a number within bounds:
`truncated_normal`; a variance: `inverse_gamma`; a covariance matrix: `inverse_wishart`.

Every one has `log_prob(x, parameters)`, `sample(key, parameters, shape)`, `mean`, `entropy`, and `fit` where an
estimate from a sample makes sense. For Gibbs samplers: `posterior` of the two inverse ones, and
`gaussian.component_given_rest`, whose result `truncated_normal` takes. Scalar distributions are elementwise over any
shape, the others take one item (`vmap` adds batches).

Not here: noise models of sensors, which glue a density to a residual.
"""

from jaxest.distributions import bingham, gaussian, inverse_gamma, inverse_wishart, truncated_normal, von_mises

__all__ = ["bingham", "gaussian", "inverse_gamma", "inverse_wishart", "truncated_normal", "von_mises"]
