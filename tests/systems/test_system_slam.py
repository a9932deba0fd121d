"""Whole-body SLAM on a small tree: biases are found, covariances hold, what cannot be known is said."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quick_compile import QUICK
from scipy.stats import multivariate_normal
from slam_models import TREE, build, errors, robot, sensors, tiny

from jaxest import kinematics
from jaxest.filters import run
from jaxest.filters.kalman import information_gain
from jaxest.manifolds import quaternion, so3
from jaxest.mapping.layout import grid
from jaxest.sensors.proximity import Proximity, ring
from jaxest.simulate import boxes
from jaxest.systems import _slam_body as bodies
from jaxest.systems import slam, slam_chain
from jaxest.systems._slam_link import repeats
from jaxest.systems._slam_rows import Points, Pose, match, moved, point_slope, sums, world
from jaxest.types import NON_FINITE, OK, InputError, Reading

STEPS = 25
SENSED = [0, 1, 2, 4]  # bodies with sensors; the tool on the slide has none
KNOWN = [0, 1, 3]  # joints whose bias the sensors tell


@pytest.fixture(scope="module")
def fixed():
    return build()


@pytest.fixture(scope="module")
def driven(fixed):
    """`(params, state, measurements) -> (state, infos)`, compiled once."""
    return jax.jit(partial(run, fixed.step), compiler_options=QUICK)


def drawn(system, seed, **options):
    draw = partial(system.simulate, system.default_params, steps=STEPS, **options)
    return jax.jit(lambda key: draw(key=key), compiler_options=QUICK)(jax.random.key(seed))


@pytest.fixture(scope="module")
def scene(fixed):
    return drawn(fixed, 0)


@pytest.fixture(scope="module")
def outcome(fixed, driven, scene):
    return driven(fixed.default_params, fixed.init(fixed.default_params), scene[0])


@pytest.mark.slow
def test_biases_of_hinges_and_a_slide_are_found(outcome, scene):
    """72 zones a link, noise of 1 %: a twentieth of a radian everywhere, also on the branch."""
    _, info = outcome
    away = errors(info, scene[1])[:, SENSED]
    assert np.all(np.asarray(info.status) == OK)
    assert away[-5:].max() < 0.02
    assert np.abs(np.asarray(info.bias)[-1, KNOWN] - 0.05).max() < 0.01
    assert np.all(np.asarray(info.bias_deviation)[-1, KNOWN] < 0.02)
    assert np.asarray(info.bias_deviation)[-1, 2] > 0.09


def test_a_link_without_sensors_follows_its_joint_and_says_so(outcome, scene):
    _, info = outcome
    names = list(robot().topology.body_names)
    status = np.asarray(info.link_status)
    assert np.all(status[:, names.index("tool")] == slam.UNSEEN)
    assert np.all(status[1:, names.index("b")] == OK)
    assert info.inliers.shape[1] == 4
    place = np.asarray(info.position)[-1]
    truth = np.asarray(scene[1].position)[-1]
    away = np.linalg.norm(place[names.index("tool")] - truth[names.index("tool")])
    assert 0.03 < away < 0.08  # the slide's own bias of 5 cm
    spread = np.asarray(info.pose_covariance)[-1, names.index("tool"), 3:, 3:]
    assert np.sqrt(np.trace(spread)) > 0.09


def test_the_map_lies_on_the_walls(outcome):
    from jaxest.systems._slam_simulation import ROOM

    state, _ = outcome
    points = state.chart.point[: int(state.chart.used)]
    away = np.asarray(boxes.surface(ROOM, points))
    assert len(points) > 200
    assert np.mean(away < 0.05) > 0.95


def test_biases_lie_within_their_deviations(fixed, driven):
    """Over 12 rooms' worth of noise and motion; 36 values of which 99.7 % would lie within 3, none may beyond 6."""
    found = []
    for seed in range(12):
        measurements, _ = drawn(fixed, 100 + seed)
        _, info = driven(fixed.default_params, fixed.init(fixed.default_params), measurements)
        deviation = np.asarray(info.bias_deviation)[-1, KNOWN]
        found.append((np.asarray(info.bias)[-1, KNOWN] - 0.05) / deviation)
    squared = np.square(found)
    # The mean of 36 squared standard normals is 1 +- 0.24; correlated residuals leave room for twice too bold.
    assert squared.mean() < 2.5
    assert squared.max() < 36


def test_nothing_seen_leaves_the_prediction(fixed, driven, scene):
    measurements, _ = scene
    blind = measurements._replace(ranges=Reading(measurements.ranges.value, np.zeros_like(measurements.ranges.valid)))
    params = fixed.default_params._replace(bias_walk=1e-3)  # by default a step adds less than float32 shows
    state, info = driven(params, fixed.init(params), blind)
    assert np.all(np.asarray(info.bias) == 0)
    np.testing.assert_allclose(info.joints, measurements.joints.value, atol=1e-6)
    assert int(state.chart.used) == 0
    status = np.asarray(info.link_status)
    assert np.all(np.isin(status, [slam.FOLLOWS, slam.UNSEEN]))
    assert np.all(np.diff(np.asarray(info.bias_deviation)[:, 0]) > 0)
    assert np.all(np.asarray(info.weakest) == 0)


def test_bad_readings_are_left_out(fixed, driven, scene):
    """NaN is told; zones beyond their limits are as good as masked."""
    measurements, _ = scene
    value, valid = (np.array(x) for x in measurements.ranges)
    valid[3:, ::7] = False
    masked = measurements._replace(ranges=Reading(value, valid))
    start = fixed.init(fixed.default_params)
    _, expected = driven(fixed.default_params, start, masked)
    for bad in (9.0, 0.01, -1.0, np.nan):
        spoiled = value.copy()
        spoiled[3:, ::7] = bad
        given = measurements._replace(ranges=Reading(spoiled, np.array(measurements.ranges.valid)))
        _, info = driven(fixed.default_params, start, given)
        np.testing.assert_allclose(info.bias, expected.bias, atol=1e-6)
        wrong = np.asarray(info.status) != OK
        assert np.all(np.asarray(info.status)[wrong] == NON_FINITE)
        assert wrong.sum() == (STEPS - 3 if np.isnan(bad) else 0)


def test_a_full_map_is_told():
    system = build()
    small = system._replace(init=partial(system.init.func, *system.init.args[:2], 100, *system.init.args[3:]))
    measurements, _ = drawn(system, 0)
    state, info = jax.jit(partial(run, system.step), compiler_options=QUICK)(
        system.default_params, small.init(system.default_params), jax.tree.map(lambda x: x[:5], measurements)
    )
    assert int(state.chart.used) == 100
    assert np.all(np.asarray(info.status) == slam.FULL)
    assert np.all(np.diff(np.asarray(info.overflow)) > 0)
    assert np.isfinite(np.asarray(info.position)).all()


def test_a_robot_that_leaves_a_grids_volume_is_told():
    """A cart drives 8 m out of the volume: what it sees there finds no room, and it goes on by its odometry alone."""
    volume = grid(np.array([-2.0, -2.5, -1.6]), np.array([3.5, 2.2, 1.9]), 0.25)
    system = tiny(layout=volume, capacity=volume.slots)
    draw = partial(system.simulate, system.default_params, steps=8)
    measurements, _ = jax.jit(draw, compiler_options=QUICK)(key=jax.random.key(0))
    away = np.array(measurements.travel.value)
    away[5] += [8.0, 0, 0]
    given = measurements._replace(travel=Reading(away, measurements.travel.valid))
    state, info = jax.jit(partial(run, system.step), compiler_options=QUICK)(
        system.default_params, system.init(system.default_params), given
    )
    assert np.all(np.asarray(info.status)[:5] == OK)
    assert np.all(np.asarray(info.status)[5:] == slam.FULL)
    assert np.all(np.asarray(info.link_status)[5:] == slam.FOLLOWS)
    assert int(info.voxels[-1]) == int(info.voxels[4])
    lost = np.diff(np.asarray(info.overflow)[4:])
    np.testing.assert_array_equal(lost, np.asarray(info.seen)[5:].sum(1))
    spread = np.trace(np.asarray(info.pose_covariance)[:, 0, 3:, 3:], axis1=1, axis2=2)
    assert np.all(np.diff(spread[4:]) > 0)
    np.testing.assert_allclose(np.linalg.norm(info.position[5, 0] - info.position[4, 0]), 8, atol=0.1)
    assert np.isfinite(np.asarray(state.covariance)).all()


def test_a_robot_that_was_carried_away_is_flagged(fixed, driven, scene):
    """Every surface is a foot farther off between two steps: the points contradict the map, and that is said."""
    measurements, _ = scene
    room = boxes.Boxes((-1.8, -2.3, -1.5), (3.3, 2.0, 1.7), ((1.0, -1.8, -1.1), (0.6, 1.7, 0.6)), ((0.4,) * 3,) * 2)
    larger, _ = drawn(fixed, 0, room=room)
    value = np.array(measurements.ranges.value)
    value[12:] = np.asarray(larger.ranges.value)[12:]
    given = measurements._replace(ranges=Reading(value, measurements.ranges.valid))
    _, info = driven(fixed.default_params, fixed.init(fixed.default_params), given)
    status = np.asarray(info.link_status)[:, SENSED]
    assert np.all(status[3:12] == OK)
    assert np.all(np.isin(status[12, 1:], [slam.LOST, slam.FOLLOWS]))


def test_a_missing_encoder_is_no_zero(fixed, driven, scene):
    measurements, truth = scene
    there = np.array(measurements.joints.valid)
    there[10:14, 1] = False
    value = np.where(there, measurements.joints.value, np.nan)
    _, info = driven(fixed.default_params, fixed.init(fixed.default_params),
                     measurements._replace(joints=Reading(value, there)))  # fmt: skip
    assert np.all(np.asarray(info.status) == OK)
    assert errors(info, truth)[-3:, SENSED].max() < 0.02


def test_the_papers_filter_is_right_on_its_own_ground():
    """The same biases; its covariances are smaller than errors, which is why it is not the default."""
    one = [s for frame in ("root", "a", "b") for s in ring(frame, 0.1, rows=3, columns=3)]
    system = slam_chain.build(robot(), one, points=72, capacity=1500)
    measurements, truth = drawn(system, 0)
    step = jax.jit(partial(run, system.step), compiler_options=QUICK)
    state, info = step(system.default_params, system.init(system.default_params), measurements)
    assert np.all(np.asarray(info.status) == OK)
    place = np.asarray(truth.position)[:, :3]
    away = np.linalg.norm(np.asarray(info.position) - place, axis=2)
    assert away[-5:].max() < 0.05
    assert int(state.index) == STEPS
    assert np.linalg.eigvalsh(np.asarray(info.covariance)).min() > -1e-6
    with pytest.raises(InputError, match="expected one joint between"):
        slam_chain.build(robot(), ring("tool", 0.1))


def test_density_of_summed_rows_is_that_of_one_large_normal(x64):
    rng = np.random.default_rng(4)
    root = rng.normal(size=(7, 4))
    covariance, design = root @ root.T, rng.normal(size=(30, 7))  # singular: some of a link is known
    weight = np.where(rng.uniform(size=30) < 0.8, rng.uniform(1, 9, 30), 0.0)
    away = rng.normal(size=30)
    gained = information_gain(
        jnp.asarray(covariance), jnp.asarray(design.T * weight) @ design, jnp.asarray(design.T @ (weight * away))
    )
    found = slam_chain.log_density(gained, jnp.asarray(away), jnp.asarray(weight))
    used = weight > 0
    dense = design[used] @ covariance @ design[used].T + np.diag(1 / weight[used])
    np.testing.assert_allclose(found, multivariate_normal(np.zeros(used.sum()), dense).logpdf(away[used]), rtol=1e-8)


@pytest.fixture(scope="module")
def free():
    """A system with a free root and its run, compiled once."""
    system = build(free=True)
    return system, jax.jit(partial(run, system.step), compiler_options=QUICK)


@pytest.fixture(scope="module")
def loose(free):
    """A free root, driven by odometry at first and by none later on."""
    system, step = free
    measurements, truth = drawn(system, 0)
    there = np.arange(STEPS) < 12
    blind = {name: getattr(measurements, name)._replace(valid=there) for name in ("travel", "turn")}
    _, info = step(system.default_params, system.init(system.default_params), measurements._replace(**blind))
    return info, truth


def test_a_free_root_is_followed_with_odometry_and_by_the_room_alone(loose):
    """It drifts by some 2 cm and 1 deg a second; without odometry it may be anywhere within 1 cm a step."""
    info, truth = loose
    assert np.all(np.asarray(info.status) == OK)
    away = errors(info, truth)[:, SENSED]
    assert away[8:12].max() < 0.035
    assert away[-5:].max() < 0.05
    assert np.abs(np.asarray(info.bias)[-1, KNOWN] - 0.05).max() < 0.015


@pytest.mark.parametrize("rate", [2.5, 15.0])
def test_a_root_that_begins_to_roll_is_followed_or_told(free, rate):
    """From rest to 0.25 rad a step it is found again without odometry; by 1.5 it is lost, and nothing enters the map.

    A root that goes on at 1.5 rad a step is then looked for at random places, and may seem to fit at a wrong one: only
    the step in which it is lost is sure.
    """
    system, step = free
    draw = partial(system.simulate, system.default_params, steps=STEPS, odometry=False, roll=rate, bias=0.0)
    measurements, truth = jax.jit(draw, compiler_options=QUICK)(key=jax.random.key(3))
    _, info = step(system.default_params, system.init(system.default_params), measurements)
    turned = jax.vmap(quaternion.from_matrix)(truth.rotation[:, 0])
    away = jax.vmap(lambda a, b: jnp.linalg.norm(quaternion.local(a, b)))(turned, info.quaternion[:, 0])
    status, voxels = np.asarray(info.status), np.asarray(info.voxels)
    assert np.all(status[: STEPS // 2] == OK)
    if rate < 10:
        assert np.asarray(away).max() < 0.05
        assert np.all(status != slam.LOST)
    else:
        first = STEPS // 2 + 1
        assert status[first] == slam.LOST
        assert voxels[first] == voxels[first - 1]


@pytest.mark.slow
def test_a_free_roots_covariance_holds_it():
    """Of the root's position where odometry ends, over 12 runs: a chi-square of 36 by 36, 1 +- 0.24."""
    system = build(free=True)
    draw = jax.jit(partial(system.simulate, system.default_params, steps=12), compiler_options=QUICK)
    step = jax.jit(partial(run, system.step), compiler_options=QUICK)
    squared = []
    for seed in range(12):
        measurements, truth = draw(key=jax.random.key(seed))
        _, info = step(system.default_params, system.init(system.default_params), measurements)
        # Nothing moves the map's frame, odometry of the first step included.
        np.testing.assert_allclose(info.position[0, 0], 0, atol=1e-5)
        error = np.asarray(info.position)[-1, 0] - np.asarray(truth.position)[-1, 0]
        squared.append(error @ np.linalg.solve(np.asarray(info.pose_covariance)[-1, 0, 3:, 3:], error) / 3)
    # Too sure by a half in the first second, while planes are read for the first time.
    assert 0.4 < np.mean(squared) < 3


def test_rows_are_the_derivatives_of_their_residuals(x64):
    """Against finite differences of a plane through fixed neighbours, by the state and by the link alone."""
    random = np.random.default_rng(0)
    layout, chart = _wall(random)
    chart = chart._replace(total=1e6 * chart.total)  # of planes read once, noise along the moved rays is a part
    pose = Pose(*(jnp.asarray(x) for x in (random.normal(size=3) * 0.1, np.eye(3), random.normal(size=(3, 4)),
                                           random.normal(size=(3, 4)))))  # fmt: skip
    local = np.column_stack([1 - pose.position[0] + np.zeros(6), random.uniform(-0.5, 0.5, (6, 2))])
    ray = local / np.linalg.norm(local, axis=1, keepdims=True)
    points = Points(*(jnp.asarray(x) for x in (local, ray, np.ones(6), np.ones(6, bool))))

    @partial(jax.jit, compiler_options=QUICK)
    def rows(v):
        return match(layout, chart, slam.Params(), moved(pose, v), points, v[1:], jnp.eye(4))

    at = rows(jnp.zeros(4))
    assert np.asarray(at.matched).all()
    for k in range(4):
        v = np.zeros(4)
        v[k] = 1e-6
        slope = (rows(jnp.asarray(v)).residual - rows(-jnp.asarray(v)).residual) / 2e-6
        np.testing.assert_allclose(at.design[:, k], slope, atol=1e-8)
    x = world(pose, points.local)
    for k in range(3):
        turned = np.asarray(so3.exp(jnp.zeros(3).at[k].set(1e-6))) @ (np.asarray(x) - np.asarray(pose.position)).T
        slope = (turned.T + np.asarray(pose.position) - np.asarray(x)) @ np.array([1.0, 0, 0]) / 1e-6
        np.testing.assert_allclose(np.abs(at.lever[:, k]), np.abs(slope), atol=1e-6)
    np.testing.assert_allclose(np.abs(at.lever[:, 3:]), np.tile([1.0, 0, 0], (6, 1)), atol=1e-7)
    moves = np.einsum("nij,j->ni", np.asarray(point_slope(pose, x)), np.ones(4) * 1e-6)
    np.testing.assert_allclose(world(moved(pose, jnp.ones(4) * 1e-6), points.local) - x, moves, atol=1e-10)


def test_a_lever_does_not_grow_with_the_error_of_its_range(x64):
    """Else residual and lever share the error, and their product turns a link: by 45 degrees of ray, 3 cm and 1 m away.

    Of a plane that is known and readings with nothing else wrong, all of the error is found and taken off.
    """
    random = np.random.default_rng(3)
    layout, chart = _wall(random)
    chart = chart._replace(total=1e6 * chart.total)
    ray, n = np.array([1.0, 0.8, 0.6]) / 2**0.5, 500
    error = 0.03 * random.normal(size=n)
    reach = 2**0.5 + error
    local = reach[:, None] * ray - [0, 0.4, 0.3]
    points = Points(*(jnp.asarray(x) for x in (local, np.tile(ray, (n, 1)), reach, np.ones(n, bool))))
    nothing = jnp.zeros((3, 4))
    pose = Pose(jnp.zeros(3), jnp.eye(3), nothing, nothing)
    exact = slam.Params(noise=0.03 / 2**0.5, uneven=0.0, lasting=0.0, share=0.0)
    found = jax.jit(
        lambda params: match(layout, chart, params, pose, points, jnp.zeros(3), jnp.eye(4)), compiler_options=QUICK
    )
    rows, naive = found(exact), found(exact._replace(uneven=10.0))
    assert np.asarray(rows.matched).all()
    signed = np.asarray(rows.lever) * np.sign(np.asarray(rows.lever)[:, 3:4])
    hit = np.array([1.0, 0.4, 0.3])
    np.testing.assert_allclose(signed[:, :3], np.tile(np.cross(hit, [1.0, 0, 0]), (n, 1)), atol=1e-6)
    # If planes were so uneven that a residual says nothing of its range,
    # the lever is that of the reading, and pulls: four standard errors from 0 at least.
    pull = np.asarray(naive.lever)[:, 1] * np.asarray(naive.residual) - 0.3 * error / 2**0.5
    assert abs(pull.mean()) > 4 * pull.std() / n**0.5


def _wall(random):
    """A map of the wall x = 1, whose points carry numbers that are linear in place."""
    from jaxest.mapping import Hashed, empty, insert

    layout = Hashed(0.2)
    y, z = np.meshgrid(np.arange(-1, 1, 0.1) + 0.05, np.arange(-1, 1, 0.1) + 0.05)
    wall = np.column_stack([np.ones(y.size), y.ravel(), z.ravel()])
    carried = np.tile(random.normal(size=9), (y.size, 1))
    chart = empty(layout, 500, 9, jnp.float64)
    return layout, insert(layout, chart, jnp.asarray(wall), jnp.ones(y.size, bool), jnp.asarray(carried))


def test_sums_marginalise_the_links_own_motion(x64):
    """Against the dense covariance: unit noise over the weight, plus what the link does on its own."""
    random = np.random.default_rng(1)
    n = 30
    design, lever, residual = random.normal(size=(n, 3)), random.normal(size=(n, 6)), random.normal(size=n)
    weight = random.uniform(0.5, 2, n) * (random.random(n) > 0.2)
    half = random.normal(size=(6, 6))
    spare = half @ half.T * 0.1
    from jaxest.systems._slam_rows import Rows

    rows = Rows(*(jnp.asarray(x) for x in (residual, design, lever, weight, weight >= 0, 0.0, 0.0)))
    points = Points(*(jnp.zeros(s) for s in ((n, 3), (n, 3), (n,))), jnp.ones(n, bool))
    found = sums(rows, points, jnp.asarray(spare))
    used = weight > 0
    inverse = np.linalg.inv(np.diag(1 / weight[used]) + lever[used] @ spare @ lever[used].T)
    np.testing.assert_allclose(found.information, design[used].T @ inverse @ design[used], rtol=1e-9)
    np.testing.assert_allclose(found.pull, -design[used].T @ inverse @ residual[used], rtol=1e-9)
    assert (int(found.inliers), int(found.matched), int(found.seen)) == (used.sum(), n, n)


def test_links_move_as_their_slopes_say(x64):
    body = bodies.body(robot(free=True), sensors())
    reading = jnp.array([0.3, -0.4, 0.05, 0.7])
    mean = bodies.Mean(jnp.array([0.1, 0.2, 0.3]), quaternion.exp(jnp.array([0.2, -0.5, 0.1])), jnp.full(4, 0.05))
    at = bodies.links(body, mean, reading, body.links)
    for k in range(body.size):
        v = jnp.zeros(body.size).at[k].set(1e-6)
        ahead, behind = (bodies.links(body, bodies.retract(body, mean, s * v), reading, body.links) for s in (1, -1))
        np.testing.assert_allclose(at.travel[:, :, k], (ahead.position - behind.position) / 2e-6, atol=1e-8)
        turned = jax.vmap(lambda a, b: so3.log(a @ b.T))(ahead.rotation, behind.rotation) / 2e-6
        np.testing.assert_allclose(at.turn[:, :, k], turned, atol=1e-8)


def test_a_link_at_rest_counts_its_scans_with_a_finite_derivative(x64):
    """A fixed root goes no way at all; of a link that moves the derivative is the finite difference."""

    @jax.jit
    def scans(by):
        """Of a root at rest, and of a link that moves and turns by as much."""
        place, turn = by * jnp.array([[0.0, 0, 0], [0.6, 0, 0.8]]), by * jnp.array([[0.0, 0, 0], [0, 0.3, 0.4]])
        after = bodies.Links(place, jax.vmap(so3.exp)(turn), place, place)
        still = jnp.zeros((2, 3))
        before = bodies.Links(still, jnp.broadcast_to(jnp.eye(3), (2, 3, 3)), still, still)
        return repeats(slam.Params(), after, before, jnp.int32(3))

    slope = jax.jit(jax.jacrev(scans))
    np.testing.assert_allclose(scans(0.0), 1 + 2 * 500, rtol=1e-5)
    assert np.isfinite(np.asarray(slope(0.0))).all()
    # A rotation by half a radian counts as 2 sin(0.25) m at the distance at which rotations count as ways.
    np.testing.assert_allclose(scans(1.0)[1], 1 + 0.4 / (1 + 2**0.5 * 2**0.5 * np.sin(0.25) + 4e-4), rtol=1e-4)
    near = (scans(0.1 + 1e-6) - scans(0.1 - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope(0.1), near, rtol=1e-6, atol=1e-6)
    assert near[1] < 0


@pytest.mark.slow  # three programs of the whole step for each
@pytest.mark.parametrize("align", [False, True])
def test_the_derivative_of_a_run_by_its_parameters_is_the_finite_difference(x64, align):
    system = tiny(free=False, align=align)
    params = jax.tree.map(jnp.float64, system.default_params._replace(tilt=0.02))
    measurements, _ = system.simulate(params, key=jax.random.key(1), steps=4)

    def loss(params):
        _, info = run(system.step, params, system.init(params), measurements)
        return jnp.sum(jnp.sin(3 * info.position[-1])) + jnp.sum(jnp.sin(10 * info.bias_deviation))

    value = jax.jit(loss, compiler_options=QUICK)
    slopes = jax.jit(jax.grad(loss), compiler_options=QUICK)(params)
    assert all(np.isfinite(slope) for slope in slopes)
    for name in ("tilt", "noise", "floor", "bias_start"):
        at, h = getattr(params, name), 1e-4 * float(getattr(params, name))
        near = value(params._replace(**{name: at + h})) - value(params._replace(**{name: at - h}))
        assert getattr(slopes, name) != 0
        np.testing.assert_allclose(getattr(slopes, name), near / (2 * h), rtol=1e-3, err_msg=name)


def test_bad_robots_and_sensors_are_named():
    with pytest.raises(InputError, match="sensors: there is none"):
        slam.build(robot(), [])
    with pytest.raises(InputError, match="frame 'tol' does not exist; did you mean 'tool'"):
        slam.build(robot(), ring("tol", 0.1))
    with pytest.raises(InputError, match="directions of length"):
        slam.build(robot(), [Proximity("a", np.zeros(3), np.full((2, 3), 0.9))])
    with pytest.raises(InputError, match="expected 0 <= min < max"):
        slam.build(robot(), [ring("a", 0.1)[0]._replace(minimum=5.0)])
    for system in (slam, slam_chain):
        with pytest.raises(ValueError, match="capacity: got 0"):
            system.build(robot(), sensors(), capacity=0)


@pytest.mark.parametrize("system", [slam, slam_chain])
def test_ranges_of_another_number_are_named(system):
    built = build(system=system)
    state = built.init(built.default_params)
    two = Reading(jnp.zeros(4), jnp.ones(4, bool))
    for count in (10, 1000):
        ranges = Reading(jnp.ones(count), jnp.ones(count, bool))
        with pytest.raises(ValueError, match=rf"measurement.ranges: got shape \({count},\), expected \(288,\)"):
            jax.eval_shape(built.step, built.default_params, state, slam.Fixed(ranges, two, jnp.float32(0.1)))


@pytest.mark.parametrize("free", [False, True])
def test_the_first_link_of_a_chain_begins_where_it_stands(free):
    text = TREE.format(joint="<freejoint/>" if free else "").replace(
        'name="root"', 'name="root" pos="1 2 .5" euler="0 0 90"'
    )
    built = slam_chain.build(kinematics.load(text), [s for name in ("root", "a") for s in ring(name, 0.1)])
    pose = built.init(built.default_params).links.pose
    np.testing.assert_allclose(pose.translation[0], [1, 2, 0.5], atol=1e-6)
    np.testing.assert_allclose(pose.rotation[0], [0.5**0.5, 0, 0, 0.5**0.5], atol=1e-6)
