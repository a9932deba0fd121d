"""Other people's particle filters on the model of the `deflection` benchmark: the same likelihood, walk and number."""

import importlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import models
from jaxest.distributions import von_mises
from jaxest.kinematics.load import compile_model
from jaxest.sensors import Sensor
from jaxest.systems import _deflection_body as bodies

READ = np.array([0.0, 0.6, 0.8, -0.3])  # what the encoders say, rad
TIP = np.array([0.3, 0.0, 0.4])  # where the marker is, m; both IMUs say that their links are level


def numpy_filter(pinocchio: Any, model: Any, count: int) -> Callable[[], Any]:
    """Return a step in NumPy that calls Pinocchio for each particle, float64.

    Args:
        pinocchio: the module.
        model: its model of the packaged arm.
        count: number of particles.
    """
    data = model.createData()
    joints = [model.getJointId(name) for name in ("shoulder", "elbow")]
    hand = model.getFrameId("hand")
    random = np.random.default_rng(0)
    state = {"x": random.vonmises(0, 0.1, (count, 4))}

    def look(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        level, tips = np.empty((count, 2)), np.empty((count, 3))
        for i, q in enumerate(x):
            pinocchio.forwardKinematics(model, data, q)
            for k, joint in enumerate(joints):
                level[i, k] = data.oMi[joint].rotation[2, 2]
            tips[i] = pinocchio.updateFramePlacement(model, data, hand).translation
        return level, tips

    def step() -> Any:
        x = _walked(random, state["x"])
        log = _log_likelihood(x, *look(x))
        weights = np.exp(log - log.max())
        ends = np.cumsum(weights / weights.sum())
        points = (np.arange(count) + random.random(count)) / count
        mean = np.arctan2(weights @ np.sin(x), weights @ np.cos(x))
        state["x"] = x[np.minimum(np.searchsorted(ends, points), count - 1)]
        return mean

    return step


def particles_filter(core: Any, count: int) -> Callable[[], Any]:
    """Return a step of the `particles` package with forward kinematics in NumPy for all particles at once, float64.

    Args:
        core: the module `particles`.
        count: number of particles.
    """
    random, look = np.random.default_rng(0), _arm()

    class Arm(core.FeynmanKac):
        def M0(self, N: int) -> Any:
            return random.vonmises(0, 0.1, (N, 4))

        def M(self, t: int, xp: Any) -> Any:
            return _walked(random, xp)

        def logG(self, t: int, xp: Any, x: Any) -> Any:
            return _log_likelihood(x, *look(x))

    smc = core.SMC(fk=Arm(10**9), N=count, resampling="stratified", ESSrmin=1.0)
    next(smc)

    def step() -> Any:
        next(smc)
        return np.arctan2(smc.W @ np.sin(smc.X), smc.W @ np.cos(smc.X))

    return step


def cuthbert_filter(robot: Any, sensors: tuple[Sensor, ...], given: tuple[Any, Any], count: int) -> tuple[Any, Any]:
    """Return a jitted step `(state, key) -> (state, mean)` of `cuthbert` on our likelihood, float32; and a state.

    Args:
        robot: the packaged arm.
        sensors: as the benchmark has them.
        given: parameters and measurement.
        count: number of particles.
    """
    particle_filter = importlib.import_module("cuthbert.smc.particle_filter")
    systematic = importlib.import_module("cuthbertlib.resampling.systematic")

    params, measurement = given
    body = bodies.body(robot, sensors, None, ())
    sampler = von_mises.fast_sampler(5.0, "float32")

    def walk(key: Any, x: Any, _: Any) -> Any:
        return von_mises.circle.wrap(x + von_mises.sample_fast(key, sampler, 0.0, (4,)))

    filtering = particle_filter.build_filter(
        lambda key: jax.random.uniform(key, (4,), minval=-jnp.pi, maxval=jnp.pi),
        walk,
        lambda before, x, seen: bodies.log_likelihood(body, params, x, seen),
        count,
        systematic.resampling,
    )

    @jax.jit
    def step(state: Any, key: Any) -> Any:
        after = filtering.filter_combine(state, filtering.filter_prepare(measurement, key=key))
        weights = jax.nn.softmax(after.log_weights)
        return after, jnp.arctan2(weights @ jnp.sin(after.particles), weights @ jnp.cos(after.particles))

    first = filtering.init_prepare(key=jax.random.key(0))._replace(model_inputs=measurement)
    return step, step(first, jax.random.key(1))[0]


def pyrecest_filter(filters: Any, count: int) -> Callable[[], Any]:
    """Return a step of `pyrecest`'s filter on the torus with forward kinematics in NumPy for all at once, float64.

    Args:
        filters: the module `pyrecest.filters`.
        count: number of particles.
    """
    random, look = np.random.default_rng(0), _arm()
    torus = filters.HypertoroidalParticleFilter(count, 4)
    torus.filter_state.d = random.vonmises(0, 0.1, (count, 4)) % (2 * np.pi)

    def likelihood(x: Any) -> Any:
        log = _log_likelihood(x, *look(x))
        return np.exp(log - log.max())

    def step() -> Any:
        torus.predict_nonlinear(lambda x: _walked(random, x), None)
        torus.update_nonlinear_using_likelihood(likelihood)
        x, w = torus.filter_state.d, torus.filter_state.w  # resampled already: there is no mean of the weighted ones
        return np.arctan2(w @ np.sin(x), w @ np.cos(x))

    return step


def blackwell_filter(
    module: Any, robot: Any, sensors: tuple[Sensor, ...], given: tuple[Any, Any], count: int
) -> Callable[[], Any]:
    """Return a step of `blackwell` on our residuals, whose squares are the likelihood, float32; its walk is Gaussian.

    Args:
        module: `blackwell.filters.particle`.
        robot: the packaged arm.
        sensors: as the benchmark has them.
        given: parameters and measurement.
        count: number of particles.
    """
    params, measurement = given
    body = bodies.body(robot, sensors, None, ())
    size = jax.eval_shape(lambda x: bodies.rows(body, params, x, measurement)[0], jnp.zeros(4)).shape[0]

    class Space:
        def retract(self, x: Any, v: Any) -> Any:
            return von_mises.circle.wrap(x + v)

    class Walk:
        def propagate(self, x: Any, control: Any, model: Any) -> Any:
            return x

        def process_covariance(self, x: Any, control: Any, model: Any) -> Any:
            return jnp.eye(4) / 5.0

    class Look:
        def observe(self, x: Any, model: Any) -> Any:
            return x

        def measurement_residual(self, seen: Any, x: Any, model: Any) -> Any:
            return bodies.rows(body, params, x, measurement)[0]

        def measurement_covariance(self, x: Any, model: Any) -> Any:
            return jnp.eye(size)

    filtering = module.BootstrapParticleFilter(Space(), Walk(), Look())

    @jax.jit
    def advance(belief: Any, key: Any) -> Any:
        key, move, choose = jax.random.split(key, 3)
        moved = filtering.predict(move, belief, None, jnp.zeros(0))
        weighed = filtering.update(moved, None, jnp.zeros(size))
        w, x = weighed.weights, weighed.particles
        return filtering.systematic_resample(choose, weighed), key, jnp.arctan2(w @ jnp.sin(x), w @ jnp.cos(x))

    held: dict[str, Any] = {"key": jax.random.key(1)}
    held["belief"] = filtering.initialise(jax.random.key(0), jnp.zeros(4), jnp.eye(4), count)

    def step() -> Any:
        held["belief"], held["key"], mean = advance(held["belief"], held["key"])
        return mean

    return step


def _walked(random: np.random.Generator, x: NDArray[np.float64]) -> NDArray[np.float64]:
    moved = x + random.vonmises(0, 5.0, x.shape)
    return (moved + np.pi) % (2 * np.pi) - np.pi


def _log_likelihood(x: NDArray[Any], level: NDArray[Any], tips: NDArray[Any]) -> NDArray[np.float64]:
    """Log-likelihood (N,), from how level links 2 and 3 are (R_zz) and where the tip is.

    The squares of an error's x and y, which the Bingham density weighs by 800, are (1 - R_zz) / 2 together.
    """
    angles = 15.0 * np.cos(READ - x).sum(1)
    found: NDArray[np.float64] = angles - ((tips - TIP) ** 2).sum(1) / 0.02 - 400.0 * (1 - level).sum(1)
    return found


def _arm() -> Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Forward kinematics of the packaged arm for angles (N, 4): R_zz (N, 2) of links 2 and 3, and the hand (N, 3)."""
    import mujoco

    model = compile_model(models.path("arm"))
    names = {model.body(i).name: i for i in range(model.nbody)}
    ways, turns, axes = model.body_pos, np.zeros((model.nbody, 9)), np.zeros((model.nbody, 3))
    joint = np.full(model.nbody, -1)
    for i in range(model.nbody):
        mujoco.mju_quat2Mat(turns[i], model.body_quat[i])
    for j in range(model.njnt):
        joint[model.jnt_bodyid[j]], axes[model.jnt_bodyid[j]] = j, model.jnt_axis[j]

    def look(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        turn, place = {0: np.broadcast_to(np.eye(3), (len(x), 3, 3))}, {0: np.zeros((len(x), 3))}
        for i in range(1, model.nbody):
            up = model.body_parentid[i]
            place[i] = place[up] + turn[up] @ ways[i]
            turn[i] = turn[up] @ turns[i].reshape(3, 3)
            if joint[i] >= 0:
                turn[i] = turn[i] @ _rotations(axes[i], x[:, joint[i]])
        return np.stack([turn[names[n]][:, 2, 2] for n in ("link2", "link3")], axis=1), place[names["hand"]]

    return look


def _rotations(axis: NDArray[np.float64], angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrices (N, 3, 3) about one axis."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    sine, rest = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    found: NDArray[np.float64] = np.eye(3) + sine * cross + rest * (cross @ cross)
    return found


__all__ = ["blackwell_filter", "cuthbert_filter", "numpy_filter", "particles_filter", "pyrecest_filter"]
