"""The packaged gripper at work in MuJoCo: it closes on a disk with real contacts or on nothing, is pushed or turned.

`perform` steps one scene and returns what IMUs on the phalanges feel, how the joints really stand, and which links
touch the disk, where and how hard. On the host, in NumPy; faults of the IMUs are added afterwards by `imus`.

Source: Santaera 2015, section V: the cases of figs. 5 to 8 and the grasps of figs. 9 and 10.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest import models
from jaxest.filters.imu import Imu
from jaxest.simulate.imu import Sensor
from jaxest.simulate.noise import corrupt
from jaxest.types import Reading

LINKS = ("left_distal", "left_middle", "left_proximal", "right_distal", "right_middle", "right_proximal", "palm")
"""The links that carry IMU 1 to 7, in this order."""
SITES = tuple(f"site:imu{i + 1}" for i in range(7))
LEADERS = ("left_q1", "left_q2", "left_q3", "right_q1", "right_q2", "right_q3")
"""The leading half of each roll-articular joint; the joint's angle is twice its."""
PULLEYS = (0.005, 0.0086, 0.014)  # m, lever of the tendon at q1, q2, q3
DISKS = {0.0245: 0.046, 0.0325: 0.050, 0.0415: 0.042}
"""Radius of each disk of Table I and how far above the palm its centre is held, m."""
THICKNESS = 0.036  # m, of the disks


class Scene(NamedTuple):
    """What happens."""

    radius: float | None = None
    """m, of the disk; None where there is none"""
    centre: tuple[float, float] = (0.0, 0.06)
    """m, where the disk is at first: across the fingers, above the palm"""
    stand: float = 2000.0
    """N/m, by which a stand holds the disk where it is"""
    friction: float = 0.6
    """between disk and links"""
    tension: float = 8.0
    """N, of either tendon when closed"""
    ratio: float = 1.0
    """of the right tendon's tension to the left one's"""
    push: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """N in the world, on the left middle phalanx, from the middle of the scene on"""
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """rad, rotation vector to which the palm turns after closing"""
    rest: float = 1.0
    """s in the zero posture before anything moves"""
    close: float = 1.5
    """s in which the tendons are tightened"""
    hold: float = 1.0
    """s afterwards"""


class Contact(NamedTuple):
    """A link that touches the disk."""

    link: str
    point: NDArray[np.float64]
    """(3,) m in the link's frame, on its surface: what a touch sensor that is fixed to the link would say"""
    force: float
    """N, along the normal"""


class Performance(NamedTuple):
    """What happened."""

    time: NDArray[np.float64]
    """(T,) s"""
    q: NDArray[np.float64]
    """(T, nq) joint coordinates of the packaged gripper"""
    rate: NDArray[np.float64]
    """(T, 7, 3) rad/s, of the links' IMUs, in their axes"""
    specific_force: NDArray[np.float64]
    """(T, 7, 3) m/s2, likewise"""
    quaternion: NDArray[np.float64]
    """(T, 7, 4) wxyz, IMUs to world"""
    contacts: tuple[Contact, ...]
    """at the end"""
    disk: NDArray[np.float64] | None
    """(3,) m, centre of the disk at the end"""


def perform(scene: Scene, *, rate_hz: int = 1000) -> Performance:
    """Let the gripper do what a scene says.

    Args:
        scene: what happens.
        rate_hz: samples per second, a divisor of 2000.

    Returns:
        What happened.
    """
    import mujoco

    model = _model(scene)
    data = mujoco.MjData(model)
    every = round(1 / (rate_hz * model.opt.timestep))
    total = scene.rest + scene.close + scene.hold
    steps = round(total / model.opt.timestep)
    shape = (steps // every, 7, 3)
    rate, force = np.empty(shape), np.empty(shape)
    q, quaternion = np.empty((shape[0], model.nq)), np.empty((*shape[:2], 4))
    sites = [model.site(f"imu{i + 1}").id for i in range(7)]
    middle = model.body("left_middle").id
    for i in range(steps):
        t = i * model.opt.timestep
        closed = _smooth((t - scene.rest) / scene.close)
        data.ctrl[:] = scene.tension * closed * np.array([1, scene.ratio])
        late = _smooth((t - scene.rest - 0.5 * scene.close) / (0.5 * scene.close))
        data.xfrc_applied[middle, :3] = late * np.array(scene.push)
        mujoco.mju_axisAngle2Quat(data.mocap_quat[0], _unit(scene.turn), late * np.linalg.norm(scene.turn))
        row = i // every
        if i % every == every - 1:
            q[row] = data.qpos  # sensors and sites are those of the state before the step
        mujoco.mj_step(model, data)
        if i % every == every - 1:
            rate[row], force[row] = data.sensordata.reshape(7, 2, 3).transpose(1, 0, 2)
            for k, site in enumerate(sites):
                mujoco.mju_mat2Quat(quaternion[row, k], data.site_xmat[site])
    mujoco.mj_forward(model, data)
    disk = None if scene.radius is None else data.body("disk").xpos.copy()
    return Performance(np.arange(1, shape[0] + 1) / rate_hz, q[:, : _joints()], rate, force, quaternion,
                       _contacts(model, data), disk)  # fmt: skip


def imus(
    found: Performance,
    sensor: Sensor,
    key: jax.Array,
    *,
    mounting: Any = None,
    field: tuple[float, float, float] = (0.0, 18e-6, -41e-6),
) -> Imu:
    """Add the faults of real IMUs to what the links feel.

    Args:
        found: what happened.
        sensor: which IMU; each draws its own faults.
        key: random key.
        mounting: (7, 3) rad, rotation vector by which each IMU is turned in its site; none if None.
        field: (3,) T, of the earth in the world.

    Returns:
        Measurements, values and flags (T, 7, ...) and `dt` (T,).
    """
    u = found.quaternion[..., 1:]
    north = np.broadcast_to(np.asarray(field, float), u.shape)
    turned = 2 * np.cross(north, u)  # the field in the IMU's axes: v + w t + t x u with t = 2 v x u
    field_seen = north + found.quaternion[..., :1] * turned + np.cross(turned, u)
    dt = np.full(len(found.time), found.time[1] - found.time[0], np.float32)
    dt[0] = 0
    readings = []
    turn = np.stack([_matrix(v) for v in (np.zeros((7, 3)) if mounting is None else np.asarray(mounting, float))])
    signals = [np.einsum("nij,tni->tnj", turn, x) for x in (found.rate, found.specific_force, field_seen)]
    for k, triad, signal in zip(jax.random.split(key, 3), sensor[:3], signals, strict=True):
        every = jax.random.split(k, 7)
        drawn = _corrupted(every, triad, jnp.asarray(signal, jnp.float32), jnp.asarray(dt))
        readings.append(Reading(drawn, jnp.ones(drawn.shape[:2], bool)))
    gyroscope, accelerometer, magnetometer = readings
    return Imu(gyroscope, accelerometer, magnetometer, jnp.asarray(dt))


@jax.jit
def _corrupted(keys: jax.Array, triad: Any, signal: jax.Array, dt: jax.Array) -> jax.Array:
    return jax.vmap(lambda k, x: corrupt(k, triad, x, dt)[0], (0, 1), 1)(keys, signal)


def calibrated_mpu6050() -> Sensor:
    """Return an MPU-6050 with its data sheet's noise and steps, after a calibration of scale, axes and zero-g offset.

    What the calibration leaves is assumed: 2 mg of offset, 0.2 % of scale, 2 mrad between axes. The zero-rate offset is
    as it comes, 20 deg/s; a rest in the zero posture has to take it away.
    """
    from jaxest.simulate.imu import G, mpu6050

    raw = mpu6050()
    left = {"scale": 0.002, "misalignment": 0.002}
    return raw._replace(
        gyroscope=raw.gyroscope._replace(**left), accelerometer=raw.accelerometer._replace(bias=0.002 * G, **left)
    )


def _model(scene: Scene) -> Any:
    import mujoco

    spec = mujoco.MjSpec.from_file(str(models.path("gripper")))
    spec.worldbody.add_body(name="holder", mocap=True)
    spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="holder", name2="palm",
                      solref=[0.004, 1])  # fmt: skip
    for side in ("left", "right"):
        tendon = spec.add_tendon(name=f"{side}_tendon")
        for joint, lever in zip(("q1", "q2", "q3"), PULLEYS, strict=True):
            tendon.wrap_joint(f"{side}_{joint}", 2 * lever)
        actuator = spec.add_actuator(name=side, target=f"{side}_tendon", trntype=mujoco.mjtTrn.mjTRN_TENDON)
        actuator.gainprm[0] = 1
    for i in range(7):
        for kind in (mujoco.mjtSensor.mjSENS_GYRO, mujoco.mjtSensor.mjSENS_ACCELEROMETER):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"imu{i + 1}")
    if scene.radius is not None:
        y, z = scene.centre
        disk = spec.worldbody.add_body(name="disk", pos=[0, y, z], gravcomp=1)
        for name, kind, axis in (("y", "SLIDE", [0, 1, 0]), ("z", "SLIDE", [0, 0, 1]), ("turn", "HINGE", [1, 0, 0])):
            disk.add_joint(name=f"disk_{name}", type=getattr(mujoco.mjtJoint, f"mjJNT_{kind}"), axis=axis,
                           damping=[0.2 if kind == "SLIDE" else 1e-5] * 3,
                           stiffness=[scene.stand if kind == "SLIDE" else 0] * 3)  # fmt: skip
        disk.add_geom(name="disk", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[scene.radius, THICKNESS / 2, 0],
                      quat=[np.sqrt(0.5), 0, np.sqrt(0.5), 0], mass=0.03, friction=[scene.friction, 0.002, 1e-4],
                      solref=[0.002, 1], solimp=[0.95, 0.99, 0.0005, 0.5, 2], condim=3)  # fmt: skip
    return spec.compile()


def _joints() -> int:
    return 4 + 2 * len(LEADERS)


def _smooth(share: float) -> float:
    x = min(max(share, 0.0), 1.0)
    return x * x * (3 - 2 * x)


def _matrix(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) of a rotation vector (3,)."""
    angle = np.linalg.norm(v)
    x, y, z = _unit(v)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)


def _unit(v: Any) -> NDArray[np.float64]:
    size = np.linalg.norm(v)
    return np.asarray(v, float) / size if size > 0 else np.array([1.0, 0, 0])


def _contacts(model: Any, data: Any) -> tuple[Contact, ...]:
    """One contact a link: the force's centre of all points at which it touches the disk, in the link's frame."""
    import mujoco

    found: dict[str, list[tuple[NDArray[np.float64], float]]] = {}
    force = np.zeros(6)
    for i, contact in enumerate(data.contact):
        names = [model.geom(int(g)).name for g in contact.geom]
        if "disk" not in names:
            continue
        link = names[1 - names.index("disk")]
        mujoco.mj_contactForce(model, data, i, force)
        if force[0] > 1e-3 and link in LINKS:
            # The surface of the link is half the (negative) distance away from the middle that MuJoCo reports.
            outward = contact.frame[:3] * (1 if names[0] == link else -1)
            found.setdefault(link, []).append((contact.pos - outward * contact.dist / 2, float(force[0])))
    contacts = []
    for link in LINKS:
        if link in found:
            total = sum(f for _, f in found[link])
            point = np.sum([p * f for p, f in found[link]], axis=0) / total
            body = data.body(link)
            contacts.append(Contact(link, body.xmat.reshape(3, 3).T @ (point - body.xpos), total))
    return tuple(contacts)


__all__ = [
    "DISKS",
    "LEADERS",
    "LINKS",
    "SITES",
    "Contact",
    "Performance",
    "Scene",
    "calibrated_mpu6050",
    "imus",
    "perform",
]
