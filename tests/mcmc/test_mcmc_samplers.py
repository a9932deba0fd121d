"""Samplers leave the joint density of parameters, path and data as it is; chains resume; a frozen path is flagged."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from mcmc_models import PARAMS, PENDULUM, case, draw, prior

from jaxest import parallel
from jaxest.distributions import inverse_gamma
from jaxest.io.chains import inference_data, sample
from jaxest.mcmc import chains, diagnostics, kernel, particle_gibbs, particle_mh, twist
from jaxest.mcmc.kernel import Params, State
from jaxest.mcmc.model import Unknown
from jaxest.systems import torque_posterior
from jaxest.types import InputError

pytestmark = pytest.mark.usefixtures("x64")
REPEATS, STEPS = 500, 9
KERNELS = {
    "gibbs": lambda: particle_gibbs.guided(PENDULUM, count=4),
    "gibbs_sequential": lambda: particle_gibbs.guided(PENDULUM, count=4, at_once=False, ancestors=True, threshold=0.9),
    "gibbs_bootstrap": lambda: particle_gibbs.baseline(PENDULUM, twist.nothing, count=30, ancestors=True),
    "gibbs_adapted": lambda: particle_gibbs.baseline(PENDULUM, twist.next_only, count=20),
    "mh": lambda: particle_mh.guided(PENDULUM, count=4),
    "mh_sequential": lambda: particle_mh.guided(PENDULUM, count=4, at_once=False),
}


def joint(key):
    """Parameters from the prior, then path and data from the model: a draw of the joint density."""
    keys = jax.random.split(key, 3)
    given = prior()
    theta = jax.random.uniform(keys[0], (1,), minval=given.low, maxval=given.high)
    unknown = Unknown(theta, inverse_gamma.sample(keys[1], given.alpha, given.beta))
    path, data = draw(PENDULUM, keys[2], STEPS, unknown)
    return unknown, path, data


def tuned(data):
    """Tuning that depends on the data and on nothing else."""
    given = prior()
    centre = (given.beta / given.alpha) ** (-1 / 3)
    first = Unknown(jnp.zeros(1), centre**-3)
    flat = jnp.stack([jnp.full(STEPS, 0.5), jnp.zeros(STEPS)], axis=1)
    linear = twist.fit_path(PENDULUM, PARAMS[PENDULUM], given, data, first, flat, 3)
    tuning = chains._tuning(PENDULUM, given, data, linear, centre, jnp.diag(0.14 * centre))
    return Params(PARAMS[PENDULUM], given, tuning)


SLOW = ("mh_sequential", "gibbs", "gibbs_sequential", "gibbs_adapted")


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n for n in KERNELS])
def test_the_joint_density_is_left_as_it_is(name):
    """Getting it right (Geweke 2004), from exact draws: some iterations later they still follow the prior."""
    sampler = KERNELS[name]()

    def later(key):
        key_draw, key_chain = jax.random.split(key)
        unknown, path, data = joint(key_draw)
        params = tuned(data)
        state = State(path, unknown, jnp.full((), -jnp.inf), jnp.zeros((), jnp.int32))

        def step(_, state):
            return sampler(params, data, state, key=key_chain)[0]

        # A particle filter's first estimate replaces none at all: that proposal is taken whatever it is.
        state = jax.lax.fori_loop(0, 40 if name.startswith("mh") else 4, step, state)
        return state.unknown

    found = jax.jit(jax.vmap(later))(jax.random.split(jax.random.key(11), REPEATS))
    given = prior()
    rank = (found.theta[:, 0] - given.low[0]) / (given.high[0] - given.low[0])
    scores = [
        rank,
        *(jax.scipy.special.gammainc(given.alpha[i], given.beta[i] / found.variances[:, i]) for i in range(3)),
    ]
    for uniform in scores:  # Kolmogorov and Smirnov's distance, at a level of 1e-4
        ordered = np.sort(np.asarray(uniform))
        distance = np.max(np.abs(ordered - (np.arange(REPEATS) + 0.5) / REPEATS)) + 0.5 / REPEATS
        assert distance < 2.23 / np.sqrt(REPEATS)


@pytest.fixture(scope="module")
def warm():
    with jax.enable_x64(True):
        one = case(PENDULUM, 40)
        start = chains.untuned(PENDULUM, one.params, one.prior, one.data, one.path, jnp.zeros(1))
        params = Params(one.params, one.prior, start)
        return one, chains.warm_up(PENDULUM, params, one.data, key=jax.random.key(0), iterations=200)[0]


def start(warm, count=4):
    one, params = warm
    states = chains.dispersed(
        PENDULUM, params.prior, one.data, params.tuning.linear, key=jax.random.key(5), count=count
    )
    return chains.init(jax.random.key(6), states)


@pytest.mark.slow
def test_samplers_agree_from_dispersed_starts(warm):
    one, params = warm
    found = {}
    samplers = {"gibbs": particle_gibbs.guided(PENDULUM), "mh": particle_mh.guided(PENDULUM),
                "collapsed": kernel.collapsed(PENDULUM)}  # fmt: skip
    for name, sampler in samplers.items():
        _, history = chains.advance(sampler, params, one.data, start(warm), 1200)
        posterior = torque_posterior.collect(PENDULUM, history, has_path=name != "collapsed")
        assert posterior.verdict.good, (name, posterior.verdict)
        assert name == "collapsed" or posterior.updates.min() > 0.8
        found[name] = posterior.summaries
    for name in found["gibbs"]:
        for other in ("mh", "collapsed"):
            a, b = found["gibbs"][name], found[other][name]
            slack = 0.05 * a.sd if other == "collapsed" else 0  # of the linearisation
            assert abs(a.mean - b.mean) < 4.5 * np.hypot(a.mcse, b.mcse) + slack, (name, other)
            assert abs(np.log(a.sd / b.sd)) < 0.15, (name, other)


def test_a_frozen_path_is_flagged(warm):
    one, params = warm
    sampler = particle_gibbs.baseline(PENDULUM, twist.nothing, count=3)
    _, history = chains.advance(sampler, params, one.data, start(warm), 60)
    verdict = torque_posterior.collect(PENDULUM, history).verdict
    assert not verdict.good
    assert "frozen" in verdict.reasons[0]


def test_chunks_resume_and_shards_give_the_same_draws(warm, tmp_path):
    one, params = warm
    sampler = particle_gibbs.guided(PENDULUM, count=4)
    first = start(warm)
    _, whole = chains.advance(sampler, params, one.data, first, 12)
    go = torque_posterior.advance(sampler, params, one.data)
    identity = (params, one.data)
    sample(go, first, 5, piece=5, folder=tmp_path, identity=identity)
    said = []
    _, resumed = sample(go, first, 12, piece=5, folder=tmp_path, identity=identity, say=said.append)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12), resumed, whole)
    assert said[-1].startswith("12 of 12 iterations")
    with pytest.raises(InputError, match="belongs to a run with other data"):
        sample(go, start(warm)._replace(key=first.key[::-1]), 5, piece=5, folder=tmp_path, identity=identity)
    _, spread = chains.advance(sampler, params, one.data, first, 12, over=parallel.mesh())
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9), spread, whole)


def test_draws_become_inference_data(tmp_path):
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip("arviz")
        draws = {"torque": np.random.default_rng(0).normal(size=(2, 50, 3))}
        found = inference_data(draws, {"accepted": np.ones((2, 50))}, names={"torque": ("joint", ["a", "b", "c"])})
        found.to_netcdf(str(tmp_path / "draws.nc"))
        assert list(found.posterior.joint.values) == ["a", "b", "c"]
    assert (tmp_path / "draws.nc").stat().st_size > 0


@pytest.mark.slow
def test_one_trace_and_the_same_numbers_without_vmap(warm):
    one, params = warm
    sampler = particle_mh.guided(PENDULUM, count=4)
    traces = []

    def counted(params, data, state, *, key):
        traces.append(1)
        return sampler(params, data, state, key=key)

    first = start(warm)
    after = first
    for _ in range(3):
        after, _ = chains.advance(counted, params, one.data, after, 1)
    assert len(traces) == 1
    alone = jax.tree.map(lambda x: x[1], first.chain)
    for _ in range(3):
        alone, info = sampler(params, one.data, alone, key=first.key[1])
    np.testing.assert_allclose(alone.path, after.chain.path[1], rtol=1e-9)
    assert diagnostics.R_HAT == 1.01
    assert info.updated.shape == (40,)


@pytest.mark.parametrize("make", [particle_gibbs.guided, particle_mh.guided, kernel.collapsed])
def test_chains_side_by_side_call_no_batched_lapack(make, x64):
    one = case(PENDULUM)
    tuning = chains.untuned(PENDULUM, one.params, one.prior, one.data, one.path, jnp.zeros(1))
    params, step = Params(one.params, one.prior, tuning), make(PENDULUM)
    states = chains.dispersed(PENDULUM, one.prior, one.data, tuning.linear, key=jax.random.key(0), count=4)
    keys = jax.random.split(jax.random.key(1), 4)
    text = jax.jit(jax.vmap(lambda s, key: step(params, one.data, s, key=key))).lower(states, keys).as_text()
    for call in re.findall(r"custom_call @lapack.*", text):
        shapes = [shape.split("x")[:-1] for shape in re.findall(r"tensor<((?:\d+x)+)[a-z]\d+>", call)]
        assert all(set(shape[:-2]) <= {"1"} for shape in shapes if len(shape) > 1), call
