"""A live step of the deflection filter beside a NumPy particle filter with Pinocchio's kinematics."""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest import kinematics, models
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


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time one live step in float32 with all sensors present, on the packaged arm of 4 joints.

    Args:
        peers: whether to run MuJoCo's kinematics of 2048 configurations of 7 joints in a Python loop, the measure of
            the machine, and a NumPy filter that calls Pinocchio for each particle.
        progress: hears what is being measured.
        small: few particles.

    Yields:
        Times per step, and times to compile.
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
        pinocchio = find_peer("pinocchio")
        model = pinocchio_model(models.path("arm"), robot)
        if pinocchio is not None and model is not None:
            candidates.append(Candidate("NumPy filter with Pinocchio", _numpy_filter(pinocchio, model, many)))
    found = race(candidates, repeats=2 if small else 15)
    machine = found.get("MuJoCo, 2048 x 7 joints in a loop")
    for name, count in (("bootstrap", many), ("guided", few)):
        condition = f"arm of 4 joints, 4 sensors, {name}, {count} particles, float32"
        yield compare("live step", condition, found[name], machine)
        peer = found.get("NumPy filter with Pinocchio")
        if name == "bootstrap" and peers:
            yield compare("live step", condition, found[name], peer, missing="" if peer else "pinocchio")
    for name in ("bootstrap", "guided"):
        yield compile_row(f"live step, {name}", found[name])


def _candidate(name: str, robot: Any, count: int, proposal: Any) -> Candidate:
    system = deflection.build(robot, SENSORS, particles=count, proposal=proposal)
    params = jax.tree.map(jnp.asarray, system.default_params)
    key = jax.random.key(0)
    measurements, _ = jax.jit(lambda key: system.simulate(params, key=key, steps=2, missing=0.0))(key)
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


def _numpy_filter(pinocchio: Any, model: Any, count: int) -> Any:
    """Return a step with the same likelihood, weights and stratified resampling, in float64."""
    data = model.createData()
    joints = [model.getJointId(name) for name in ("shoulder", "elbow")]
    hand = model.getFrameId("hand")
    random = np.random.default_rng(0)
    state = {"x": random.vonmises(0, 0.1, (count, 4))}
    u, seen = np.array([0.0, 0.6, 0.8, -0.3]), (np.eye(3), np.eye(3), np.array([0.3, 0.0, 0.4]))

    def step() -> Any:
        x = state["x"] + random.vonmises(0, 5.0, (count, 4))
        x = (x + np.pi) % (2 * np.pi) - np.pi
        turns, tips = np.empty((count, 2, 3, 3)), np.empty((count, 3))
        for i, q in enumerate(x):
            pinocchio.forwardKinematics(model, data, q)
            for k, joint in enumerate(joints):
                turns[i, k] = data.oMi[joint].rotation
            tips[i] = pinocchio.updateFramePlacement(model, data, hand).translation
        log = 15.0 * np.cos(u - x).sum(1) - ((tips - seen[2]) ** 2).sum(1) / 0.02
        for k in range(2):
            # The squares of a quaternion's x and y are (1 + R_xx - R_yy - R_zz) / 4 and so on.
            error = np.einsum("ij,nkj->nik", seen[k], turns[:, k])
            log -= 400.0 * (1 - error[:, 2, 2])
        weights = np.exp(log - log.max())
        ends = np.cumsum(weights / weights.sum())
        points = (np.arange(count) + random.random(count)) / count
        mean = np.arctan2(weights @ np.sin(x), weights @ np.cos(x))
        state["x"] = x[np.minimum(np.searchsorted(ends, points), count - 1)]
        return mean

    return step
