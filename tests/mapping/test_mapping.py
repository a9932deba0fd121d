"""Voxel maps against dictionaries and SciPy's tree, planes against LAPACK."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import cKDTree

from jaxest import mapping
from jaxest.mapping.layout import grid
from jaxest.mapping.planes import eigenvalues
from jaxest.types import InputError

HASHED = mapping.Hashed(0.2)
DENSE = grid(np.array([-2.5, -2.5, -2.5]), np.array([2.5, 2.5, 2.5]), 0.2)


def walls(seed, count):
    """Points on the walls of a cube of 4 m."""
    random = np.random.default_rng(seed)
    point = random.uniform(-2, 2, (count, 3))
    axis = random.integers(0, 3, count)
    point[np.arange(count), axis] = np.sign(point[np.arange(count), axis]) * 2
    return point


@partial(jax.jit, static_argnums=0, static_argnames=("central", "most"))
def put(layout, chart, point, valid, extra, central=False, most=1000.0):
    return mapping.insert(layout, chart, point, valid, extra, central=central, most=most)


@pytest.fixture(params=[HASHED, DENSE], ids=["hashed", "dense"])
def layout(request):
    return request.param


def filled(layout, dtype, batches=4, capacity=4096):
    chart = mapping.empty(layout, capacity, 2, dtype)
    points = [walls(seed, 300).astype(dtype) for seed in range(batches)]
    for point in points:
        chart = put(layout, chart, point, np.ones(300, bool), point[:, :2] * 3)
    return chart, np.concatenate(points)


def test_a_voxel_holds_the_mean_of_its_points_and_of_what_they_carry(layout, dtype):
    chart, points = filled(layout, dtype)
    cells = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / dtype.type(0.2)).astype(int)), []).append(point)
    used = int(chart.used)
    assert used == len(cells)
    assert int(chart.overflow) == 0
    found = np.asarray(chart.point)[:used]
    expected = np.array([np.mean(group, axis=0) for group in cells.values()])
    distance, nearest = cKDTree(expected).query(found)
    tolerance = 30 * np.finfo(dtype).eps
    assert distance.max() < tolerance
    assert len(set(nearest)) == used
    np.testing.assert_allclose(mapping.carried(chart)[:used], found[:, :2] * 3, atol=10 * tolerance)
    assert found.dtype == dtype


def test_a_voxel_holds_how_its_points_scatter_about_their_mean(layout, dtype):
    chart, points = filled(layout, dtype)
    cells = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / dtype.type(0.2)).astype(int)), []).append(point.astype(float))
    means = np.array([np.mean(group, axis=0) for group in cells.values()])
    squares = np.array([np.cov(np.array(group).T, bias=True)[np.triu_indices(3)] for group in cells.values()])
    used = int(chart.used)
    index = cKDTree(means).query(np.asarray(chart.point)[:used])[1]
    found = mapping.moments(chart, jnp.arange(used))
    np.testing.assert_allclose(found, squares[index], atol=40 * np.finfo(dtype).eps * 0.04)


def test_noise_of_readings_is_no_part_of_a_surface():
    """A wall at the middle of a voxel, read 4000 times with a deviation of 2 cm along slanting rays, in scans of 8."""
    random = np.random.default_rng(5)
    y, z = random.uniform(0.01, 0.19, (2, 500, 8))
    ray = np.float32([0.8, 0.6, 0.0])
    wall = np.stack([np.full_like(y, 0.1), y, z], axis=-1)
    noise = np.broadcast_to(0.02 * ray, wall.shape[1:])
    chart = blind = mapping.empty(HASHED, 4)
    insert = jax.jit(lambda chart, point, noise: mapping.insert(
        HASHED, chart, point, np.ones(8, bool), filed=jnp.full((8, 3), 0.1), noise=noise))  # fmt: skip
    for points, errors in zip(wall, random.normal(size=(500, 8, 1)), strict=True):
        read = (points + 0.02 * ray * errors).astype(np.float32)
        chart, blind = insert(chart, read, noise.astype(np.float32)), insert(blind, read, jnp.zeros((8, 3)))
    depth, scattered = (float(mapping.moments(one, jnp.arange(1))[0, 0]) for one in (chart, blind))
    variance = 0.016**2
    standard_error = variance * (2 / 4000) ** 0.5
    assert abs(scattered - variance) < 4 * standard_error
    assert abs(depth) < 4 * standard_error
    np.testing.assert_allclose(chart.point, blind.point)


def test_a_plane_is_that_of_all_points_of_its_voxels(x64):
    """Five voxels of 40 points each: plane and thickness are those of the 200 points, not of five means."""
    random = np.random.default_rng(8)
    points = random.uniform(0, 0.2, (5, 40, 3)) * [1, 1, 0.3] + random.uniform(0, 0.4, (5, 1, 3)) * [1, 1, 0.2]
    mean = points.mean(axis=1)
    within = np.stack([np.cov(one.T, bias=True)[np.triu_indices(3)] for one in points]).T[:, :, None]
    planes = mapping.fit(tuple(jnp.asarray(x[:, None]) for x in mean.T), jnp.ones((5, 1), bool), None, within)
    value, vector = np.linalg.eigh(np.cov(points.reshape(-1, 3).T, bias=True))
    np.testing.assert_allclose(planes.thickness[0], value[0] ** 0.5, rtol=1e-9)
    np.testing.assert_allclose(abs(planes.normal[0] @ vector[:, 0]), 1, rtol=1e-12)
    inside = (mean - mean.mean(axis=0)) @ vector[:, 1:]
    np.testing.assert_allclose(planes.spread[0], np.linalg.eigvalsh(inside.T @ inside / 5)[0] ** 0.5, rtol=1e-9)


def test_a_step_finer_than_a_voxel_is_no_plane():
    """A pillar's face 11 cm before a wall: a plane fits the voxels' means, and their points not at all."""
    random = np.random.default_rng(9)
    across, height = random.uniform(-0.5, 0.5, 20_000), random.uniform(0, 0.6, 20_000)
    depth = np.where(across > 0.06, 0.0, 0.11) + 0.04
    points = np.stack([across, depth, height], axis=1).astype(np.float32)
    chart = put(HASHED, mapping.empty(HASHED, 256), points, np.ones(len(points), bool), None)
    at = jnp.asarray(np.float32([[0.08, 0.04, 0.3], [-0.3, 0.15, 0.3]]))
    near = mapping.nearest(HASHED, chart, at)
    beside = tuple(chart.point[:, i][near.row] for i in range(3))
    within = jnp.moveaxis(mapping.moments(chart, near.row), -1, 0)
    means, all_points = mapping.fit(beside, near.there), mapping.fit(beside, near.there, None, within)
    assert float(means.thickness[0]) < 0.012 and abs(float(means.normal[0, 1])) < 0.99
    assert float(all_points.thickness[0]) > 0.03
    assert float(all_points.thickness[1]) < 1e-3


def test_invalid_points_change_nothing(layout):
    chart, points = filled(layout, np.dtype("float32"))
    half = np.arange(300) % 2 == 0
    one = put(layout, chart, points[:300], half, points[:300, :2])
    other = put(layout, chart, np.where(half[:, None], points[:300], 1e6), half, points[:300, :2])
    jax.tree.map(np.testing.assert_array_equal, one, other)
    assert float(one.total[:, 3].sum() - chart.total[:, 3].sum()) == 150


def test_what_finds_no_room_is_counted():
    chart = mapping.empty(HASHED, 10)
    chart = put(HASHED, chart, walls(0, 300).astype(np.float32), np.ones(300, bool), None)
    assert int(chart.used) == 10
    assert int(chart.overflow) + int(chart.total[:, 3].sum()) == 300
    full = chart
    chart = put(HASHED, chart, walls(1, 300).astype(np.float32), np.ones(300, bool), None)
    assert int(chart.used) == 10
    assert int(chart.overflow) + int(chart.total[:, 3].sum()) == 600
    np.testing.assert_array_equal(full.slot, chart.slot)
    # Another place that folds onto a slot in use, 12.8 m further.
    far = np.asarray(full.point[:1]) + np.array([[12.8, 0, 0]], np.float32)
    after = put(HASHED, mapping.empty(HASHED, 10), np.asarray(full.point[:1]), np.ones(1, bool), None)
    after = put(HASHED, after, far, np.ones(1, bool), None)
    assert (int(after.used), int(after.overflow)) == (1, 1)
    outside = put(DENSE, mapping.empty(DENSE, 10), np.full((3, 3), 4.0, np.float32), np.ones(3, bool), None)
    assert (int(outside.used), int(outside.overflow)) == (0, 3)


def test_places_that_share_a_slot_are_kept_apart_within_one_scan():
    """Two points 8 cells apart on a table of 8 cells: the one that comes second has no room, as in a later scan."""
    layout = mapping.Hashed(0.2, (8, 8, 8))
    points = np.float32([[0.1, 0.1, 0.1], [1.7, 0.1, 0.1], [0.5, 0.1, 0.1]])
    chart = mapping.insert(layout, mapping.empty(layout, 16), points, np.ones(3, bool))
    assert (int(chart.used), int(chart.overflow)) == (2, 1)
    found = np.asarray(chart.point)[:2]
    assert all(np.abs(points - one).max(axis=1).min() < 1e-6 for one in found)


def test_means_forget_beyond_their_most():
    chart = mapping.empty(HASHED, 4)
    for value in [0.05] * 40 + [0.15] * 40:
        point = np.array([[value, 0.1, 0.1]], np.float32)
        chart = put(HASHED, chart, point, np.ones(1, bool), None, most=4.0)
    assert float(chart.total[0, 3]) <= 8
    assert float(chart.point[0, 0]) > 0.145


def test_the_central_point_stays():
    chart = mapping.empty(HASHED, 100, 1)
    random = np.random.default_rng(0)
    points = random.uniform(0, 0.4, (5, 64, 3)).astype(np.float32)
    for batch in points:
        chart = put(HASHED, chart, batch, np.ones(64, bool), batch[:, :1], central=True)
    every = points.reshape(-1, 3)
    cell = np.floor(every / np.float32(0.2))
    off = np.linalg.norm(every - (cell + 0.5) * 0.2, axis=1)
    for row in range(int(chart.used)):
        mine = np.all(cell == np.floor(np.asarray(chart.point[row]) / np.float32(0.2)), axis=1)
        np.testing.assert_array_equal(chart.point[row], every[mine][np.argmin(off[mine])])
    np.testing.assert_array_equal(mapping.carried(chart)[:8, 0], chart.point[:8, 0])


def test_neighbours_are_those_of_a_tree(layout, dtype):
    """Within two voxels all of them; ties closer than a part in 65,000 may change places."""
    chart, _ = filled(layout, dtype)
    points = np.asarray(chart.point)[: int(chart.used)]
    query = (walls(9, 200) + np.random.default_rng(9).normal(0, 0.05, (200, 3))).astype(dtype)
    found = jax.jit(partial(mapping.nearest, layout, cap=0.4))(chart, query)
    distance, _ = cKDTree(points).query(query, 5, distance_upper_bound=0.4)
    ours = np.linalg.norm(np.asarray(chart.point)[np.asarray(found.row)] - query[None], axis=2).T
    np.testing.assert_array_equal(np.asarray(found.there).T, np.isfinite(distance))
    np.testing.assert_allclose(np.where(np.isfinite(distance), ours, 0), np.where(np.isfinite(distance), distance, 0),
                               rtol=2e-5, atol=1e-6)  # fmt: skip
    nothing = jax.jit(partial(mapping.nearest, layout))(chart, np.zeros((3, 3), dtype))
    assert not np.asarray(nothing.there).any()


def test_the_neighbourhood_is_bounded():
    with pytest.raises(ValueError, match="reach: got 3"):
        mapping.nearest(HASHED, mapping.empty(HASHED, 1), jnp.zeros((1, 3)), reach=3)
    with pytest.raises(ValueError, match="capacity: got 0"):
        mapping.empty(HASHED, 0)
    with pytest.raises(InputError, match="powers of two"):
        mapping.Hashed(0.2, (60, 64, 32))
    with pytest.raises(InputError, match="beyond lower"):
        grid(np.zeros(3), -np.ones(3))


def test_planes_are_those_of_lapack(dtype):
    """Also through the origin, far from it, and thin; both eigenvalues within some eps of the largest."""
    random = np.random.default_rng(0)
    turns = np.linalg.qr(random.normal(size=(200, 3, 3)))[0]
    flat = random.uniform(-2, 2, (200, 5, 3)) * np.array([0.2, 0.15, 0.004])
    points = (
        np.einsum("nij,nkj->nki", turns, flat)
        + random.uniform(-3, 3, (200, 1, 3)) * (np.arange(200) % 2)[:, None, None]
    )
    points = points.astype(dtype)
    given = tuple(points[:, :, i].T for i in range(3))
    planes = jax.jit(mapping.fit)(given, np.ones((5, 200), bool))
    centred = points.astype(float) - points.astype(float).mean(1, keepdims=True)
    values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred) / 5)
    cosine = np.abs(np.sum(np.asarray(planes.normal) * vectors[:, :, 0], axis=1))
    eps = np.finfo(dtype).eps
    gap = (values[:, 1] - values[:, 0]) / values[:, 2]
    assert np.all(1 - cosine < 200 * eps / gap**2)
    np.testing.assert_allclose(np.asarray(planes.thickness) ** 2, values[:, 0], atol=30 * eps * values[:, 2].max())
    np.testing.assert_allclose(np.asarray(planes.spread) ** 2, values[:, 1], atol=30 * eps * values[:, 2].max())
    np.testing.assert_allclose(planes.center, points.mean(1), atol=10 * eps)
    np.testing.assert_array_equal(planes.valid, np.sqrt(values[:, 1]) > 0.03)
    assert planes.normal.dtype == dtype


def test_lines_and_too_few_points_are_no_planes():
    line = np.linspace(0, 0.5, 5)[:, None] * np.array([[1.0, 0.3, -0.2]])
    given = tuple(jnp.asarray(line[:, i : i + 1]) for i in range(3))
    assert not bool(mapping.fit(given, jnp.ones((5, 1), bool)).valid[0])
    square = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.2, 0.2, 0], [9, 9, 9]])
    given = tuple(jnp.asarray(square[:, i : i + 1]) for i in range(3))
    there = jnp.array([[True], [True], [True], [True], [False]])
    found = mapping.fit(given, there)
    assert bool(found.valid[0])
    np.testing.assert_allclose(np.abs(found.normal[0]), [0, 0, 1], atol=1e-6)
    assert not bool(mapping.fit(given, there & (jnp.arange(5)[:, None] < 2)).valid[0])


def test_planes_have_derivatives_also_where_they_are_exact(x64):
    """The squared distance of a point from the plane of its neighbours, against finite differences."""
    points = np.array([[0, 0, 0], [0.2, 0, 0.01], [0, 0.2, 0], [0.2, 0.2, 0], [0.1, 0.1, 0.02]])

    def away(points):
        plane = mapping.fit(tuple(points[:, i : i + 1] for i in range(3)), jnp.ones((5, 1), bool))
        return jnp.sum(plane.normal[0] * (jnp.array([0.1, 0.2, 0.3]) - plane.center[0])) ** 2

    slope = jax.grad(away)(jnp.asarray(points))
    for index in np.ndindex(5, 3):
        step = np.zeros((5, 3))
        step[index] = 1e-6
        difference = (away(points + step) - away(points - step)) / 2e-6
        np.testing.assert_allclose(slope[index], difference, atol=1e-7)
    points[:, 2] = 0
    assert np.isfinite(jax.grad(away)(jnp.asarray(points))).all()
    low, middle = eigenvalues(tuple(jnp.zeros(1) for _ in range(6)))
    assert (float(low[0]), float(middle[0])) == (0, 0)


def test_merging_is_inserting_all(layout):
    one, _ = filled(layout, np.dtype("float32"), 2)
    other = mapping.empty(layout, 2048, 2)
    more = walls(77, 300).astype(np.float32)
    other = put(layout, other, more, np.ones(300, bool), more[:, :2] * 3)
    merged = jax.jit(partial(mapping.merge, layout))(one, other)
    both = put(layout, one, more, np.ones(300, bool), more[:, :2] * 3)
    assert int(merged.used) == int(both.used)
    ours, theirs = (np.asarray(c.point)[: int(c.used)] for c in (merged, both))
    distance, index = cKDTree(theirs).query(ours)
    assert distance.max() < 1e-5
    np.testing.assert_allclose(mapping.carried(merged)[: len(ours)], mapping.carried(both)[index], atol=1e-4)
    scattered = mapping.moments(both, jnp.asarray(index))
    np.testing.assert_allclose(mapping.moments(merged, jnp.arange(len(ours))), scattered, atol=1e-7)


def test_a_shifted_map_is_the_map_of_shifted_points():
    chart, _ = filled(HASHED, np.dtype("float32"))
    moved = mapping.shift(chart, np.full((4096, 3), 0.01, np.float32))
    used = int(chart.used)
    np.testing.assert_allclose(moved.point[:used], chart.point[:used] + 0.01, atol=1e-6)
    assert not np.asarray(moved.point[used:]).any()
    np.testing.assert_allclose(moved.total[:used, :3] / moved.total[:used, 3:4], moved.point[:used], atol=2e-6)


def test_a_scattered_wall_has_thinner_layers():
    """A wall 2 cm beyond a voxel's border, read with a deviation of 8 cm: where readings fall it has two layers."""
    random = np.random.default_rng(3)
    there, ray = np.ones(200, bool), np.tile(np.float32([1, 0, 0]), (200, 1))
    scatter = np.full(200, 0.08, np.float32)
    file = jax.jit(mapping.likeliest, static_argnums=0)
    charts = [mapping.empty(HASHED, 4096), mapping.empty(HASHED, 4096)]
    for _ in range(30):
        wall = np.column_stack([1.02 + 0.08 * random.normal(size=200), random.uniform(-1, 1, (200, 2))])
        wall = wall.astype(np.float32)
        charts[0] = put(HASHED, charts[0], wall, there, None)
        filed = file(HASHED, charts[1], wall, ray, scatter)
        # Only along the ray, and no farther than readings scatter.
        assert np.abs(filed - wall)[:, 1:].max() == 0
        assert np.abs(filed - wall)[:, 0].max() < 3.01 * 0.08
        charts[1] = mapping.insert(HASHED, charts[1], wall, there, filed=filed)
    off = []
    for chart in charts:
        read = np.asarray(chart.total)[: int(chart.used), 3]
        away = np.asarray(chart.point)[: int(chart.used), 0] - 1.02
        off.append(np.sqrt(np.sum(read * away**2) / read.sum()))
    # Each half of a normal distribution has its mean .8 deviations off. Some of the first readings, when the map was
    # empty, stay where they fell.
    assert abs(off[0] - 0.8 * 0.08) < 0.01
    assert off[1] < 0.7 * off[0]


def test_readings_that_scatter_are_compared_with_what_was_read_often():
    """A wall of 50 readings a voxel, and strays of one reading each beside a point that fell among them."""
    y, z = (v.ravel() for v in np.meshgrid(np.arange(-0.5, 0.6, 0.2), np.arange(-0.5, 0.6, 0.2)))
    wall = np.column_stack([np.full(y.size, 1.1), y, z]).astype(np.float32)
    strays = wall + np.float32([0.2, 0, 0])
    chart = mapping.empty(HASHED, 500)
    for _ in range(50):
        chart = put(HASHED, chart, wall, np.ones(y.size, bool), None)
    chart = put(HASHED, chart, strays, np.ones(y.size, bool), None)
    point = np.float32([[1.28, 0.1, 0.1]])
    by_distance, by_likelihood = (
        mapping.nearest(HASHED, chart, jnp.asarray(point), scatter) for scatter in (None, jnp.float32([0.1]))
    )
    assert np.asarray(by_distance.there).all() and np.asarray(by_likelihood.there).all()
    np.testing.assert_allclose(np.asarray(chart.point)[by_distance.row[0, 0], 0], 1.3, atol=1e-6)
    np.testing.assert_allclose(np.asarray(chart.point)[by_likelihood.row[:, 0], 0], 1.1, atol=1e-5)


def test_planes_weigh_their_points():
    random = np.random.default_rng(4)
    points, weight = random.normal(size=(50, 5, 3)).astype(np.float32), random.uniform(0.1, 9, (50, 5))
    planes = mapping.fit(tuple(points[:, :, i].T for i in range(3)), np.ones((5, 50), bool), jnp.float32(weight.T))
    share = weight / weight.sum(1, keepdims=True)
    center = np.einsum("nk,nki->ni", share, points)
    away = points - center[:, None]
    values, vectors = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", share, away, away))
    np.testing.assert_allclose(planes.center, center, atol=1e-6)
    np.testing.assert_allclose(np.asarray(planes.thickness) ** 2, values[:, 0], atol=1e-5)
    assert np.median(np.abs(np.sum(np.asarray(planes.normal) * vectors[:, :, 0], axis=1))) > 0.9999


def test_a_plane_turns_with_its_neighbours(x64):
    """Any small turn and shift of the neighbours of noisy planes, against planes laid again through the moved ones."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-1, 1, (40, 5, 3)) * [0.3, 0.3, 0.002]
    points = np.einsum("nij,nkj->nki", np.linalg.qr(rng.normal(size=(40, 3, 3)))[0], points)
    points = points + rng.normal(size=(40, 1, 3))
    turn, travel, small = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.1, -0.2]), 1e-5
    there, weight = jnp.ones((5, 40), bool), jnp.asarray(rng.uniform(0.5, 2, (5, 40)))
    x = jnp.asarray(points.mean(1) + 0.2 * rng.normal(size=(40, 3)))

    def laid(moved):
        beside = tuple(jnp.asarray((points + moved * small)[:, :, i].T) for i in range(3))
        return mapping.fit(beside, there, weight), beside

    def height(planes):
        return jnp.sum(planes.normal * (x - planes.center), axis=1)

    moved = np.cross(turn, points) + travel
    (planes, beside), (again, _) = laid(0 * moved), laid(moved)
    assert np.sum(planes.valid) > 35
    share = mapping.influence(planes, beside, x)
    np.testing.assert_allclose(jnp.sum(share, axis=0), 1, atol=1e-9)
    along = jnp.einsum("kn,nki,ni->n", share, moved, planes.normal)
    same = jnp.sign(jnp.sum(planes.normal * again.normal, axis=1))
    fine = np.asarray(planes.valid)
    np.testing.assert_allclose(((height(planes) - same * height(again)) / small)[fine], along[fine], atol=0.05)
    # What a plane moves by at the centroid is not that.
    assert np.abs(along - jnp.einsum("kn,nki,ni->n", planes.share, moved, planes.normal)).max() > 0.3


def test_influence_has_derivatives_also_where_there_is_no_plane():
    points = tuple(jnp.zeros((5, 1)).at[:, 0].set(jnp.arange(5.0) * (i == 0)) for i in range(3))

    def far(x):
        planes = mapping.fit(points, jnp.ones((5, 1), bool))
        return jnp.sum(mapping.influence(planes, points, x) ** 2)

    assert np.all(np.isfinite(jax.grad(far)(jnp.array([[0.3, 0.2, 0.1]]))))
