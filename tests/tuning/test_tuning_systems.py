"""Noise and forgetting of the estimators, by likelihood: against dense normal densities, and found again from data."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from jaxest import kinematics, tuning
from jaxest.systems import onsite_drift, torque, torque_evidence, torque_model
from jaxest.systems.torque_data import data_of, paper_prior
from jaxest.types import Reading

QUICK = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
PENDULUM = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/><geom type="capsule"
fromto="0 0 0 0 0 -.5" size=".02" mass="1"/></body></worldbody></mujoco>"""
SD = float(np.sqrt(2e-7))
NOISE = torque_evidence.Noise(np.array([SD]), np.array([SD]), np.zeros(0), np.array([SD]))
ROW = onsite_drift.build(half_width=7)


def swing(seed, steps, missing=0.0):
    """A pendulum's angles under a constant torque, with noise of 2e-7 throughout."""
    robot = kinematics.load(PENDULUM)
    given = torque.default_params(robot)._replace(mean=jnp.array([0.5, 0.0, 0.8]))
    measured, _ = torque.simulate(given, key=jax.random.key(seed), steps=steps, dt=0.01, missing=missing)
    return robot, data_of(measured)


@pytest.mark.parametrize("walks", [pytest.param(True, marks=pytest.mark.slow), False], ids=["walks", "constant"])
def test_evidence_of_angles_is_that_of_one_large_normal(walks, x64):
    robot, data = swing(1, 9, missing=0.2)
    model = torque_model.walk(1) if walks else torque_model.constant(1)
    prior = paper_prior(jnp.array([0.5]), 1, high=5.0)
    noise = NOISE
    if walks:
        noise = NOISE._replace(torque_noise=np.array([0.1]))
        prior = prior._replace(low=jnp.zeros(0), high=jnp.zeros(0), alpha=jnp.full(4, 3.0), beta=jnp.full(4, 8e-7),
                               mean=jnp.array([0.5, 0.0, 0.0]), variance=jnp.array([2e-7, 2e-7, 4.0]))  # fmt: skip
    series = torque_evidence.linearized(model, robot, prior, data)
    found = float(torque_evidence.log_evidence(model, prior, noise, series))
    # x = path + a u with u = (start, noise of every step, torque if constant), all normal; the torque is flat.
    path, jacobian, offset, design = (np.asarray(x) for x in series[1:5])
    steps, n = path.shape
    process = np.asarray(noise.variances)[:n]
    flat = 1e4 if not walks else 0.0
    mean, spread = offset[0], np.diag(np.asarray(prior.variance))
    means, rows = [mean], [np.hstack([np.eye(n), np.zeros((n, n * (steps - 1) + model.linear))])]
    for t in range(1, steps):
        row = jacobian[t] @ rows[-1]
        row[:, n * t : n * (t + 1)] += np.eye(n)
        if model.linear:
            row[:, -1:] += design[t]
        rows.append(row)
        means.append(jacobian[t] @ means[-1] + offset[t])
    inner = np.diag([*np.diag(spread), *np.tile(process, steps - 1), *[flat] * model.linear])
    pick = np.asarray(data.valid)[:, 0]
    a = np.array([row[0] for row in rows])[pick]
    centre = np.array([path[t, 0] + means[t][0] for t in range(steps)])[pick]
    dense = a @ inner @ a.T + np.eye(pick.sum()) * float(noise.sensor_noise[0]) ** 2
    expected = multivariate_normal(centre, dense).logpdf(np.asarray(data.value)[pick, 0])
    expected += np.log(2 * np.pi * flat) / 2 if model.linear else 0.0
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.slow
def test_noise_of_torques_is_found_again_where_the_angles_tell_it(x64):
    """Position and sensor noise within three standard errors; that of the speeds, too small to be seen, is said to be
    unidentified."""
    model, prior = torque_model.constant(1), paper_prior(jnp.array([0.5]), 1, high=5.0)
    logs = [swing(10 + seed, 150) for seed in range(4)]
    batch = tuning.padded(
        [tuning.recording(torque_evidence.linearized(model, robot, prior, data)) for robot, data in logs]
    )
    objective = tuning.density(partial(torque_evidence.log_evidence, model, prior))
    start = torque_evidence.Noise(jnp.array([3 * SD]), jnp.array([2 * SD]), jnp.zeros(0), jnp.array([SD / 3]))
    space = tuning.space(start, ["position_noise", "velocity_noise", "sensor_noise"])
    problem = tuning.Problem(objective, space)
    found = tuning.minimise(problem, batch, starts=space.pack(start, jnp.float64)[None], evaluations=60)
    rows = tuning.estimates(problem, found.point, tuning.curvature(problem, found.point, batch))
    for row in (rows[0], rows[2]):
        assert row.identified
        assert row.sd < 0.15 * SD
        assert abs(row.value - SD) < 3 * row.sd, row
    assert not rows[1].identified
    z = space.pack(start, jnp.float64)
    evaluate = jax.jit(lambda z: tuning.value_and_gradient(problem, z, batch), compiler_options=QUICK)
    numeric = [(evaluate(z + 1e-5 * e)[0] - evaluate(z - 1e-5 * e)[0]) / 2e-5 for e in np.eye(3)]
    np.testing.assert_allclose(evaluate(z)[1], numeric, rtol=1e-5, atol=1e-5)


def windows(seed, count=200):
    """Rows of a shaken link without noise, of a pose that the whole recording tells exactly."""
    rng = np.random.default_rng(seed)
    slope = np.zeros((count, 6, 9))
    slope[:, :3, :3], slope[:, 3:, :3] = (rng.normal(0, s, (count, 3, 3)) for s in (1.5, 6.0))
    slope[:, :3, 3:6] = np.eye(3)
    slope[:, 3:, 6:] = rng.normal(0, 4, (count, 3, 3))
    return onsite_drift.Row(
        Reading(np.zeros((count, 6)), rng.uniform(size=count) > 0.1), slope, np.full(count, 0.2), np.full(count, 0.15)
    )


LINK = onsite_drift.Params(0.01, 0.08, 0.9985, 0.996)


def test_likelihood_of_a_rigid_link_is_that_of_one_large_normal(x64):
    params = jax.tree.map(jnp.float64, LINK._replace(forgetting_rotation=1.0, forgetting_position=1.0))
    rows, _ = ROW.simulate(params, key=jax.random.key(0), rows=jax.tree.map(jnp.asarray, windows(0, 12)))
    loss = tuning.likelihood(ROW).loss(params, tuning.recording(rows), None)
    there = np.asarray(rows.seen.valid)
    a, y = np.asarray(rows.slope)[there].reshape(-1, 9), np.asarray(rows.seen.value)[there].reshape(-1)
    noise = np.tile(0.2 * np.array([*[2e-4] * 3, *[0.0064] * 3]), there.sum())
    dense = a @ np.diag([*[1.0] * 3, *[0.18] * 3, *[1.0] * 3]) @ a.T + np.diag(noise)
    np.testing.assert_allclose(-loss, multivariate_normal(np.zeros(len(y)), dense).logpdf(y), rtol=1e-6)


def tuned(params, logs):
    draw = jax.jit(lambda key, rows: ROW.simulate(params, key=key, rows=rows)[0], compiler_options=QUICK)
    batch = tuning.padded([
        tuning.recording(jax.tree.map(np.asarray, draw(jax.random.key(50 + k), windows(k)))) for k in range(logs)
    ])  # fmt: skip
    start = jax.tree.map(jnp.float64, onsite_drift.Params())
    space = tuning.space(start, ["gyroscope_noise", "force_noise", "forgetting_rotation", "forgetting_position"])
    problem = tuning.Problem(tuning.likelihood(ROW), space)
    found = tuning.minimise(problem, batch, starts=space.pack(start, jnp.float64)[None], evaluations=50)
    rows = tuning.estimates(problem, found.point, tuning.curvature(problem, found.point, batch))
    return problem, batch, space, dict(zip(space.names, rows, strict=True))


def test_forgetting_is_found_again_where_the_link_drifts(x64):
    params = jax.tree.map(jnp.float64, LINK)
    problem, batch, space, found = tuned(params, 4)
    for name, row in found.items():
        assert row.identified, name
        assert abs(row.value - float(getattr(params, name))) < 3 * row.sd, row
    assert found["forgetting_position"].sd < 0.25 * (1 - params.forgetting_position)
    evaluate = jax.jit(lambda z: tuning.value_and_gradient(problem, z, batch), compiler_options=QUICK)
    z = space.pack(space.base, jnp.float64)
    numeric = [(evaluate(z + 1e-5 * e)[0] - evaluate(z - 1e-5 * e)[0]) / 2e-5 for e in np.eye(4)]
    np.testing.assert_allclose(evaluate(z)[1], numeric, rtol=1e-5, atol=1e-5)


def test_forgetting_of_a_rigid_link_is_said_to_be_unidentified(x64):
    rigid = jax.tree.map(jnp.float64, LINK._replace(forgetting_rotation=1.0, forgetting_position=1.0))
    *_, found = tuned(rigid, 4)
    for name in ("forgetting_rotation", "forgetting_position"):
        assert not found[name].identified
        assert found[name].value > 1 - 1e-4  # about all there is is kept: a window is 15 of 3000 samples
    for name in ("gyroscope_noise", "force_noise"):
        assert found[name].identified
        assert abs(found[name].value - float(getattr(rigid, name))) < 3 * found[name].sd
