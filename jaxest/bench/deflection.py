"""A live step of the deflection filter beside other people's particle filters on the same model."""

from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
from jaxest.bench import deflection_accuracy, deflection_parts, deflection_peers
from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, find_peer, race
from jaxest.bench.robots import pinocchio_model
from jaxest.io.report import Row
from jaxest.sensors import Sensor
from jaxest.systems import deflection

SENSORS = (
    Sensor("joint_angle", "joints"),
    Sensor("link_orientation", "imu2", ("link2",)),
    Sensor("link_orientation", "imu3", ("link3",)),
    Sensor("link_position", "tip", ("hand",)),
)
"""Sato 2023, Table I."""

PEERS = {
    "NumPy filter with Pinocchio": "pinocchio",
    "particles with vectorised NumPy": "particles",
    "cuthbert, same likelihood": "cuthbert",
    "pyrecest with vectorised NumPy": "pyrecest.filters",
    "blackwell, same likelihood": "blackwell.filters.particle",
}
"""What is raced beside the bootstrap filter, and the package it needs. `particles` asks for NumPy 1: install it with
`pip install --no-deps particles`."""


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time one live step in float32 with all sensors present, on the packaged arm of 4 joints.

    Args:
        peers: whether to run MuJoCo's kinematics of 2048 configurations of 7 joints in a Python loop, the measure of
            the machine, and the filters of `PEERS`.
        progress: hears what is being measured.
        small: few particles.

    Yields:
        Times per step, each filter's error of the posterior mean, and times to compile.
    """
    progress("deflection")
    robot = kinematics.load(models.path("arm"))
    many, few = (32, 16) if small else (2048, 256)
    candidates: list[Candidate] = []
    for name, count, proposal in (
        ("bootstrap", many, deflection.bootstrap),
        ("guided", few, deflection.guided),
    ):
        candidates.append(_candidate(name, robot, count, proposal))
    if peers:
        candidates.append(Candidate("MuJoCo, 2048 x 7 joints in a loop", _mujoco_loop(many)))
        candidates += _peers(robot, many)
    found = race(candidates, repeats=2 if small else 15)
    machine = found.get("MuJoCo, 2048 x 7 joints in a loop")
    for name, count in (("bootstrap", many), ("guided", few)):
        condition = f"arm of 4 joints, 4 sensors, {name}, {count} particles, float32"
        yield compare("live step", condition, found[name], machine)
        for peer, package in PEERS.items() if name == "bootstrap" and peers else ():
            yield compare(
                "live step",
                condition,
                found[name],
                found.get(peer),
                missing="" if peer in found else package.split(".")[0],
            )
    problem = _problem(robot, many, deflection.bootstrap)
    yield from deflection_parts.rows(robot, SENSORS, problem, many, progress, small)
    if peers:
        progress("deflection: accuracy")
        filters = _means(robot, candidates, many)
        yield from deflection_accuracy.rows(robot, SENSORS, filters, many, small)
    for name in ("bootstrap", "guided"):
        yield compile_row(f"live step, {name}", found[name])


def _peers(robot: Any, count: int) -> list[Candidate]:
    """The filters of others that are installed."""
    pinocchio, core, cuthbert, torus, blackwell = (find_peer(package) for package in PEERS.values())
    numpy, particles, jitted, wrapped, gaussian = PEERS
    found = []
    model = pinocchio_model(models.path("arm"), robot)
    if pinocchio is not None and model is not None:
        found.append(Candidate(numpy, deflection_peers.numpy_filter(pinocchio, model, count)))
    if core is not None:
        found.append(Candidate(particles, deflection_peers.particles_filter(core, count)))
    if torus is not None:
        found.append(Candidate(wrapped, deflection_peers.pyrecest_filter(torus, count)))
    _, params, measurements = _problem(robot, count, deflection.bootstrap)
    first = jax.tree.map(lambda x: x[0], measurements)
    if blackwell is not None:
        given = params, deflection_accuracy.still(SENSORS)
        found.append(Candidate(gaussian, deflection_peers.blackwell_filter(blackwell, robot, SENSORS, given, count)))
    if cuthbert is not None:
        step, state = deflection_peers.cuthbert_filter(robot, SENSORS, (params, first), count)
        key = jax.random.key(1)
        found.append(Candidate(jitted, lambda: step(state, key)))
    return found


def _means(robot: Any, candidates: Sequence[Candidate], count: int) -> dict[str, Any]:
    """The peers as filters that go on from step to step on the measurement of `deflection_accuracy`."""
    filters = {one.name: one.call for one in candidates if one.name in PEERS}
    name = list(PEERS)[2]
    if name in filters:
        params = _problem(robot, count, deflection.bootstrap)[1]
        given = params, deflection_accuracy.still(SENSORS)
        step, state = deflection_peers.cuthbert_filter(robot, SENSORS, given, count)
        held = {"state": state, "key": jax.random.key(2)}

        def advance() -> Any:
            held["key"], own = jax.random.split(held["key"])
            held["state"], mean = step(held["state"], own)
            return mean

        filters[name] = advance
    return filters


def _problem(robot: Any, count: int, proposal: Any) -> tuple[Any, Any, Any]:
    """The system, its parameters in float32, and two measurements."""
    system = deflection.build(robot, SENSORS, particles=count, proposal=proposal)
    params = jax.tree.map(jnp.asarray, system.default_params)
    draw = jax.jit(lambda key: system.simulate(params, key=key, steps=2, missing=0.0))
    return system, params, draw(jax.random.key(0))[0]


def _candidate(name: str, robot: Any, count: int, proposal: Any) -> Candidate:
    system, params, measurements = _problem(robot, count, proposal)
    key = jax.random.key(0)
    step = jax.jit(lambda params, state, measurement: system.step(params, state, measurement, key=key))
    state = system.init(params, key=key)
    first, second = (jax.tree.map(lambda x, i=i: x[i], measurements) for i in range(2))
    one = candidate(name, step, params, state, first)
    state, _ = step(params, state, first)
    return one._replace(call=lambda: step(params, state, second))


def _mujoco_loop(count: int) -> Any:
    import mujoco

    model = mujoco.MjModel.from_xml_string(models.chain(7))
    data = mujoco.MjData(model)
    postures = np.random.default_rng(0).uniform(-2, 2, (count, 7))

    def loop() -> None:
        call = mujoco.mj_kinematics
        for q in postures:
            data.qpos[:] = q
            call(model, data)

    return loop
