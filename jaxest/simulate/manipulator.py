"""A manipulator of joint modules and crooked sticks in MuJoCo: its IMUs while it swings a joint, and what it drops.

On the host: the servos, the arm's inertia and the ball are MuJoCo's, the sensors' faults those of `simulate.noise`.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.calibration.imu import Readings
from jaxest.kinematics.modular import TOOL, Assembly, Module, known
from jaxest.kinematics.urdf_frames import turned
from jaxest.manifolds.se3 import Pose
from jaxest.simulate import tumble
from jaxest.simulate.imu import Sensor
from jaxest.simulate.manipulator_model import BOX, STEP, WALL, Sticks, model
from jaxest.simulate.noise import Triad, corrupt

RATE = 85.0  # Hz, of the IMUs. Source: Sato 2024, section IV-C.
REST = 4.0  # s before the swinging, for the gyros' biases
TURN = 2.0  # s that one joint swings before another is drawn
ABOVE = 0.05  # m, the gripper over the box


class Recording(NamedTuple):
    """What the IMUs say, by link and by end of the link (before it, behind it)."""

    time: tuple[tuple[NDArray[np.float64], ...], ...]
    """[link][end] (n,) s, stamps."""
    gyroscope: tuple[tuple[NDArray[np.float64], ...], ...]
    """[link][end] (n, 3) rad/s."""
    accelerometer: tuple[tuple[NDArray[np.float64], ...], ...]
    """[link][end] (n, 3) m/s2."""
    swung: tuple[int, ...]
    """Which joint swings, `TURN` seconds each, from `REST` on."""
    tumbled: tuple[tuple[Readings, ...], ...]
    """[link][end] the same IMU before it was built in, turned over on a plate (`jaxest.calibration.tumble`)."""


class Drop(NamedTuple):
    """How a reach ends."""

    inside: bool
    """Whether the ball lies in the box."""
    ball: NDArray[np.float64]
    """(3,) m, where it comes to rest."""
    gripper: NDArray[np.float64]
    """(3,) m, where the gripper let go, the servos' sag included."""


FLATNESS = 3e-4  # rad, of a block's faces on a plate: 15 um on 50 mm


def mems() -> Sensor:
    """Return a small MEMS IMU as it comes, its axes off by 1 %."""
    return Sensor(
        Triad(density=1e-4, bias=0.05, walk=1e-5, scale=0.01, misalignment=0.01, limit=35.0, resolution=1e-3),
        Triad(density=1.5e-3, bias=0.3, walk=1e-5, scale=0.01, misalignment=0.01, limit=78.0, resolution=2.4e-3),
        jitter=3e-4,
        drop=0.02,
    )


def draw(seed: int, *, limit: float = 1.6) -> Sticks:
    """Put a manipulator together from what lies around.

    A base turns about the vertical and carries `joint1`; two sticks, 0.18 to 0.32 m long and bent twice by up to 30
    deg, lead to `joint2` and `joint3`, mounted at any angle up to 60 deg about them; behind `joint3` a gripper.

    The paper speaks of joints 1 to 3, which pitch; the base's joint below them, without which the first link would turn
    about one axis only and not be determined, is inferred.

    Args:
        seed: which one.
        limit: rad, of the pitch joints to either side.

    Returns:
        The manipulator.
    """
    random = np.random.default_rng(seed)
    before = known(_rotation([0, math.pi / 2, 0]), np.array([-0.03, 0.004, 0.015]))
    after = known(_rotation([math.pi / 2, 0, 0]), np.array([0.03, -0.004, 0.015]))
    modules = [
        Module("joint0", axis=(0.0, 0.0, 1.0), limits=(-2.6, 2.6)),
        Module("joint1", None, after, limits=(-limit, limit)),
    ]
    modules += [
        Module("joint2", before, after, limits=(-limit, limit)),
        Module("joint3", before, None, limits=(-limit, limit)),
    ]
    riser = known(translation=[0.0, 0.0, 0.06])
    drawn = [_stick(random) for _ in range(2)]
    base, tool = known(translation=[0.0, 0.0, 0.25]), known(translation=[0.11, 0.0, 0.0])
    assembly = Assembly(tuple(modules), (riser, None, None), base, tool)
    return Sticks(assembly, tuple(link for link, _ in drawn), tuple(bends for _, bends in drawn))


def _stick(random: np.random.Generator) -> tuple[Pose, NDArray[np.float64]]:
    """The next module's pose in the horn that a bent stick is on, and the stick's corners."""
    rotation, corner = np.eye(3), np.zeros(3)
    corners = [corner]
    for part in random.dirichlet([8, 8, 8]) * random.uniform(0.18, 0.32):
        corner = corner + rotation @ [part, 0, 0]
        corners.append(corner)
        axis = random.normal(size=3) * [0, 1, 1]
        rotation = rotation @ turned(axis / np.linalg.norm(axis), random.uniform(0, math.radians(30)))
    rotation = rotation @ turned(np.array([1.0, 0, 0]), random.uniform(-1, 1) * math.radians(60))
    return known(_quaternion(rotation), corner), np.array(corners)


def _rotation(vector: list[float]) -> Any:
    angle = float(np.linalg.norm(vector))
    return np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) / max(angle, 1e-12) * np.array(vector)])


def _quaternion(r: NDArray[np.float64]) -> Any:
    """Quaternion (4,) of a rotation that is no half turn."""
    w = math.sqrt(max(1 + np.trace(r), 1e-12)) / 2
    return np.array([w, *(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w))])


def swing(
    sticks: Sticks, seed: int, *, seconds: float = 60.0, amplitude: float = 0.35, rate_hz: float = 1.3,
    sensor: Sensor | None = None,
) -> Recording:  # fmt: skip
    """Swing one joint after the other, drawn at random, and record the IMUs.

    Args:
        sticks: the manipulator.
        seed: of joints, sampling times and sensors.
        seconds: of swinging, after a rest of `REST`.
        amplitude: rad.
        rate_hz: Hz, of the swinging.
        sensor: which IMUs; `mems()` if None.

    Returns:
        The recording: each IMU samples at its own moments.

    Source: Sato 2024, section IV-C.
    """
    import mujoco

    random = np.random.default_rng([seed, 1])
    arm = mujoco.MjModel.from_xml_string(model(sticks))
    data = mujoco.MjData(arm)
    centre = np.array([0.0, -0.4, 0.7, 0.2])[: arm.nu]
    data.qpos[:] = centre
    swinging = arm.nu - 1  # what is behind the last joint is known
    swung = tuple(int(j) for j in random.integers(0, swinging, math.ceil(seconds / TURN)))
    steps = round((REST + seconds) / STEP)
    read = np.empty((steps, arm.nsensordata))
    at = np.asarray(np.arange(steps) * STEP, np.float64)
    turn = np.clip((at - REST) / TURN, 0, len(swung) - 1e-9)
    share = turn % 1
    wave = amplitude * np.sin(2 * np.pi * rate_hz * share * TURN) * np.minimum(1, 4 * np.minimum(share, 1 - share))
    wave[at < REST] = 0
    which = np.array(swung)[turn.astype(int)]
    data.ctrl[:] = centre
    mujoco.mj_forward(arm, data)
    for i in range(steps):
        data.ctrl[:] = centre
        data.ctrl[which[i]] += wave[i]
        mujoco.mj_step(arm, data)
        read[i] = data.sensordata
    return _recorded(sticks, arm, at, read, random, sensor or mems(), swung)


def _recorded(
    sticks: Sticks, arm: Any, at: NDArray[np.float64], read: NDArray[np.float64], random: np.random.Generator,
    sensor: Sensor, swung: tuple[int, ...],
) -> Recording:  # fmt: skip
    names = [arm.site(i).name for i in range(arm.nsite) if arm.site(i).name != TOOL]
    columns: list[list[tuple[Readings, Readings]]] = []
    modules = sticks.assembly.modules
    for k in sticks.assembly.unknown:
        ends = (f"{modules[k].name}_after", f"{modules[k + 1].name}_before")
        columns.append([_sampled(at, read, names.index(end), random, sensor) for end in ends])
    parts = [tuple(tuple(end[0][i] for end in link) for link in columns) for i in range(3)]
    time, rates, forces = parts
    return Recording(time, rates, forces, swung, tuple(tuple(end[1] for end in link) for link in columns))


def _sampled(
    at: NDArray[np.float64], read: NDArray[np.float64], number: int, random: np.random.Generator, sensor: Sensor
) -> tuple[Readings, Readings]:
    """One IMU's readings while the robot swings, and before, on the plate: late, some lost, each with its faults."""
    block = tumble.draw(random, flatness=FLATNESS)
    counts = [int(block.duration * RATE), int((at[-1] - 2 / RATE) * RATE)]
    first, true = (_moments(count, random, sensor) for count in counts)
    perfect = tumble.ideal(block, first)
    dt = jnp.asarray(np.concatenate([np.diff(x, prepend=x[0]) for x in (first, true)]), jnp.float32)
    kept = [random.uniform(size=count) >= float(np.asarray(sensor.drop)) for count in counts]
    found: list[list[NDArray[np.float64]]] = [[first[kept[0]]], [true[kept[1]]]]
    for part, triad in enumerate((sensor.gyroscope, sensor.accelerometer)):
        columns = slice(6 * number + 3 * part, 6 * number + 3 * part + 3)
        ideal = np.stack([np.interp(true, at, column) for column in read[:, columns].T], axis=1)
        key = jax.random.key(int(random.integers(2**31)))
        whole = jnp.asarray(np.concatenate([perfect[part], ideal]), jnp.float32)
        readings = np.asarray(_corrupt(key, triad, whole, dt), np.float64)
        for place, rows in enumerate(np.split(readings, [counts[0]])):
            found[place].append(rows[kept[place]])
    return Readings(*found[1]), Readings(*found[0])


def _moments(count: int, random: np.random.Generator, sensor: Sensor) -> NDArray[np.float64]:
    """When samples are taken, s."""
    late = np.clip(float(np.asarray(sensor.jitter)) * random.normal(size=count), -1e-3, 1e-3)
    return np.asarray((np.arange(count) + random.uniform(0, 1)) / RATE + late, np.float64)


@jax.jit
def _corrupt(key: Any, triad: Triad, value: Any, dt: Any) -> Any:
    return corrupt(key, triad, value, dt)[0]


def drop(sticks: Sticks, q: NDArray[np.float64], box: NDArray[np.float64], *, move: float = 3.0) -> Drop:
    """Bring the gripper to joint angles and let the ball go.

    Args:
        sticks: the manipulator as it really is.
        q: (4,) rad, commanded.
        box: (3,) m, the middle of the box's floor.
        move: s, on the way.

    Returns:
        How it ends, two seconds later.
    """
    import mujoco

    arm = mujoco.MjModel.from_xml_string(model(sticks, box))
    data = mujoco.MjData(arm)
    start, ball = np.array([0.0, -0.4, 0.7, 0.2]), arm.joint("ball")
    data.qpos[:4] = start
    tool = arm.site(TOOL).id
    held = np.zeros(3)
    for i in range(round((move + 3.0) / STEP)):
        share = min(i * STEP / move, 1.0)
        data.ctrl[:] = start + (np.asarray(q) - start) * share * share * (3 - 2 * share)
        if i * STEP < move + 1.0:
            mujoco.mj_kinematics(arm, data)
            held = data.site_xpos[tool].copy()
            data.qpos[ball.qposadr[0] : ball.qposadr[0] + 3] = held
            data.qvel[ball.dofadr[0] : ball.dofadr[0] + 6] = 0
        mujoco.mj_step(arm, data)
    rest = data.qpos[ball.qposadr[0] : ball.qposadr[0] + 3].copy()
    away = rest - np.asarray(box)
    inside = bool(np.all(np.abs(away[:2]) < BOX[:2]) and -WALL < away[2] < BOX[2])
    return Drop(inside, rest, held)


__all__ = [
    "ABOVE",
    "BOX",
    "FLATNESS",
    "RATE",
    "REST",
    "TURN",
    "Drop",
    "Recording",
    "Sticks",
    "draw",
    "drop",
    "mems",
    "model",
    "swing",
]
