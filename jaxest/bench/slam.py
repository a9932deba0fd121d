"""A whole-body step beside SciPy's neighbour search for the same points, and small_gicp's alignment of each link."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics
from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, find_peer, race
from jaxest.filters import run
from jaxest.filters.run import last
from jaxest.io.report import Row
from jaxest.manifolds import quaternion
from jaxest.simulate import proximity, rooms
from jaxest.systems import _slam_body as bodies
from jaxest.systems import slam
from jaxest.types import Reading

CASES = ((20, 128), (20, 512), (5, 128), (5, 512))
WARM = 30  # steps that build the map before the clock starts


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time one live step in float32, all 512 zones of a link put into the map, ray casting left out.

    Args:
        peers: whether to run `scipy.spatial.cKDTree` (5 neighbours of the same points in the same map) and
            `small_gicp`'s point-to-plane alignment of each link's points.
        progress: hears what is being measured.
        small: a structure of 2 links with few zones.

    Yields:
        Times per step, and times to compile.
    """
    for links, points in ((2, 8),) if small else CASES:
        progress(f"slam: {links} links, {points} points")
        yield from _case(links, points, peers, small)


def problem(links: int, points: int, zones: int = 8) -> tuple[Any, slam.Fixed]:
    """Return the system of a structure that moves in a room, and what it measures, leaves (WARM + 2, ...)."""
    robot, sensors = kinematics.load(rooms.structure(links)), rooms.sensors(links, rows=zones, columns=zones)
    model = proximity.compiled(rooms.scene(links, rooms.room(0)))
    time, q = proximity.inside(model, 0, duration=0.1 * (WARM + 2))
    scan = proximity.cast(model, sensors, q, time)
    faults = proximity.Faults()
    ranges, there = (jnp.asarray(x) for x in proximity.corrupt(scan, sensors, faults, 0))
    joints = jnp.asarray(proximity.encoders(q, faults, 0), jnp.float32)
    given = slam.Fixed(Reading(ranges, there), Reading(joints, jnp.ones(joints.shape, bool)),
                       jnp.full(len(joints), 0.1, jnp.float32))  # fmt: skip
    return slam.build(robot, sensors, points=points), given


def live(step: Any, params: Any, state: Any, measurement: Any) -> Callable[[], Any]:
    """Return a call that goes on from where the last one ended, and gives its state away."""
    held = {"state": state}

    def go() -> Any:
        held["state"], info = step(params, held["state"], measurement)
        return info

    return go


def _case(links: int, points: int, peers: bool, small: bool) -> Iterable[Row]:
    zones = 2 if small else 8
    robot, sensors = kinematics.load(rooms.structure(links)), rooms.sensors(links, rows=zones, columns=zones)
    system, given = problem(links, points, zones)
    params = jax.tree.map(jnp.float32, system.default_params)
    measurement = jax.tree.map(lambda x: x[-1], given)
    # The state is given away at each call, as a live loop gives it away: its map is changed in place.
    step = jax.jit(system.step, donate_argnums=1)
    empty = system.init(params)
    name = f"{links} links, {points} points"
    one = candidate(name, step, params, empty, measurement)
    state, _ = run(system.step, params, empty, jax.tree.map(lambda x: x[:WARM], given), history=last)
    candidates = [one._replace(call=live(step, params, jax.tree.map(jnp.copy, state), measurement))]
    clouds = _clouds(state, measurement, sensors, robot, points)
    chart = np.asarray(state.chart.point)[: int(state.chart.used)]
    tree = find_peer("scipy.spatial") if peers else None
    gicp = find_peer("small_gicp") if peers else None
    if tree is not None:
        candidates.append(Candidate("cKDTree, 5 neighbours", partial(_trees, tree, chart, clouds)))
    if gicp is not None:
        candidates.append(Candidate("small_gicp, point to plane", _alignments(gicp, chart, clouds)))
    found = race(candidates, repeats=2 if small else 15)
    condition = f"{name} a link, float32"
    yield compare("live step", condition, found[name], found.get("cKDTree, 5 neighbours"), unit="ms",
                  missing="scipy" if peers and tree is None else "")  # fmt: skip
    if peers:
        yield compare("live step", condition, found[name], found.get("small_gicp, point to plane"), unit="ms",
                      missing="small_gicp" if gicp is None else "")  # fmt: skip
    yield compile_row(f"live step, {condition}", found[name])


def _clouds(state: Any, measurement: Any, sensors: Any, robot: Any, points: int) -> list[np.ndarray]:
    """Return each link's points (n, 3) m in the world, as many as take part in an update."""
    body = bodies.body(robot, sensors)
    seen = slam.points_of(body, measurement.ranges)
    frames = kinematics.forward(robot, bodies.posture(body, state.mean, measurement.joints.value))
    rotation = np.asarray(jax.vmap(quaternion.to_matrix)(frames.quaternion))
    place = np.asarray(frames.position)
    local, valid = np.asarray(seen.local), np.asarray(seen.valid)
    every = max(1, local.shape[1] // points)
    return [
        (local[k][::every] @ rotation[link].T + place[link])[valid[k][::every]].astype(float)
        for k, link in enumerate(body.scanned)
    ]


def _trees(spatial: Any, chart: np.ndarray, clouds: list[np.ndarray]) -> None:
    """Look for neighbours link by link; the tree is built once a step, though each link changes the map."""
    tree = spatial.cKDTree(chart)
    for cloud in clouds:
        tree.query(cloud, 5, distance_upper_bound=0.5)


def _alignments(gicp: Any, chart: np.ndarray, clouds: list[np.ndarray]) -> Any:
    """Return a call that aligns each link's points with the map on one thread; its normals are made beforehand."""
    target = gicp.PointCloud(chart.astype(float))
    tree = gicp.KdTree(target)
    gicp.estimate_normals(target, tree, num_neighbors=5, num_threads=1)
    sources = [gicp.PointCloud(cloud) for cloud in clouds]

    def align() -> None:
        for source in sources:
            gicp.align(target, source, tree, registration_type="PLANE_ICP", max_correspondence_distance=0.5,
                       num_threads=1, max_iterations=5)  # fmt: skip

    return align


__all__ = ["rows"]
