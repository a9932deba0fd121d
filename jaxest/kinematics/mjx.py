"""The same quantities by MuJoCo's own engine in JAX (MJX), and what only a simulator gives: rollouts and sensors.

Slower than `jaxest.kinematics` and loaded only when this module is used. Call it through `mjx.jit`: on CPU, XLA's
fusion recomputes MJX's chains of links exponentially often, which a plain `jax.jit` cannot prevent. Build one backend
and close over it; passing it as an argument costs up to a millisecond a call.
"""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxest.kinematics.forward import Frames
from jaxest.kinematics.inertia import check_inertia
from jaxest.kinematics.load import compile_model, load
from jaxest.kinematics.robot import Robot, frame
from jaxest.manifolds import quaternion as quat
from jaxest.types import Array, ArrayLike, InputError

with contextlib.redirect_stdout(io.StringIO()):  # it tells there which other engines it has not found
    from mujoco import mjx

NO_FUSION = (
    {"xla_cpu_use_fusion_emitters": False}
    if jax.__version_info__ < (0, 11)
    else {"xla_disable_hlo_passes": "fusion,multi_output_fusion"}
)


def jit(fn: Callable[..., Any], **options: Any) -> Any:
    """Compile a function that calls MJX: `jax.jit` with the option without which a chain of 7 links takes milliseconds.

    Args:
        fn: the function.
        options: of `jax.jit`.

    Returns:
        The jitted function; on other platforms than CPU just `jax.jit(fn)`. It cannot be called within another jit.
    """
    return jax.jit(fn, compiler_options=NO_FUSION if jax.default_backend() == "cpu" else None, **options)


class Backend(NamedTuple):
    """A robot in MJX."""

    robot: Robot
    """The same robot as `jaxest.kinematics` has it: names and conventions."""
    model: Any
    """mjx.Model"""
    blank: Any
    """mjx.Data to start from"""
    sensor_names: tuple[str, ...]
    sensor_slices: tuple[tuple[int, int], ...]
    """where each sensor's values stand in `sensordata`"""


class State(NamedTuple):
    """A robot's state."""

    q: Array
    """(nq,) rad or m."""
    v: Array
    """(nv,) rad/s or m/s."""


class Rollout(NamedTuple):
    """States and sensors after each step of a simulation."""

    state: State
    """leaves (T, ...)"""
    sensors: dict[str, Array]
    """name -> (T, dim), the model's own sensors, in MuJoCo's units; those of the state before the step."""


def build(source: str | Path, *, contacts: bool = False, constraints: bool = True) -> Backend:
    """Load a robot or a scene into MJX.

    Args:
        source: path of an MJCF or URDF file, or its text.
        contacts: keep collisions. MJX lacks some pairs of shapes and then refuses the model.
        constraints: keep joint limits, equality constraints and dry friction; without them a rollout can be
            differentiated in reverse mode, with them in forward mode only.

    Returns:
        The backend, with the sensors of the file.

    Raises:
        FileNotFoundError: no such file.
        InputError: the file is no robot, or MJX cannot simulate it, or a range finder would look through a shape that
            MJX casts no rays at; the message says what is missing.
    """
    import mujoco

    model = compile_model(source)
    ranging = _rays(model, source if str(source)[:1] != "<" else "robot text")
    if not contacts:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        model.geom_contype[:] = 0
        model.geom_conaffinity[:] = 0
    if not constraints:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    try:
        ours = mjx.put_model(model)
    except NotImplementedError as error:
        raise InputError(
            f"{source if str(source)[:1] != '<' else 'robot text'}: MJX cannot simulate it: {error}"
        ) from None
    if ranging and not model.nmat:  # its rays look a material up for every shape, also for those without one
        ours = ours.replace(mat_rgba=jnp.ones((1, 4), ours.geom_rgba.dtype))
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_SENSOR, i) or f"sensor{i}" for i in range(model.nsensor)]
    ends = [(int(a), int(a + n)) for a, n in zip(model.sensor_adr, model.sensor_dim, strict=True)]
    return Backend(load(source), ours, mjx.make_data(ours), tuple(names), tuple(ends))


def _rays(model: Any, source: Any) -> bool:
    """Tell whether there are range finders; refuse shapes that MJX lets their rays pass through."""
    import mujoco

    eyes = model.sensor_objid[model.sensor_type == int(mujoco.mjtSensor.mjSENS_RANGEFINDER)]
    kinds = [int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("CYLINDER", "HFIELD", "SDF")]
    own = {int(body) for body in model.site_bodyid[eyes]}
    unseen = [
        model.geom(i).name or f"geom{i} of body {model.body(model.geom_bodyid[i]).name}"
        for i in range(model.ngeom)
        if model.geom_type[i] in kinds and model.geom_rgba[i, 3] > 0 and own - {int(model.geom_bodyid[i])}
    ]
    if unseen:
        raise InputError(
            f"{source}: range finders of MJX look through cylinders, height fields and SDFs: {', '.join(unseen[:5])}; "
            'give them another shape (capsule, box, mesh), or rgba="0 0 0 0" if they shall not be seen'
        )
    return len(eyes) > 0


def _at(backend: Backend, q: ArrayLike, v: ArrayLike | None = None) -> Any:
    q = jnp.asarray(q)
    data = backend.blank.replace(qpos=q)
    return data if v is None else data.replace(qvel=jnp.asarray(v, q.dtype))


def forward(backend: Backend, q: ArrayLike) -> Frames:
    """Compute the poses of all frames, as `jaxest.kinematics.forward` does.

    Args:
        backend: the robot.
        q: (nq,).

    Returns:
        Positions (n, 3) m and quaternions (n, 4) wxyz, bodies then sites.
    """
    data = mjx.kinematics(backend.model, _at(backend, q))
    sites = jax.vmap(quat.from_matrix)(data.site_xmat.reshape(-1, 3, 3))
    position = jnp.concatenate([data.xpos[1:], data.site_xpos])
    return Frames(position, jnp.concatenate([data.xquat[1:], sites]))


def jacobian(backend: Backend, q: ArrayLike, name: int | str) -> Array:
    """Compute a frame's Jacobian, as `jaxest.kinematics.jacobian` does.

    Args:
        backend: the robot.
        q: (nq,).
        name: static, index or name of the frame.

    Returns:
        (6, nv), rotation then translation.

    Raises:
        InputError: the frame does not exist.
    """
    index = frame(backend.robot, name) if isinstance(name, str) else int(name)
    bodies = len(backend.robot.topology.body_names)
    data = mjx.com_pos(backend.model, mjx.kinematics(backend.model, _at(backend, q)))
    body = index if index < bodies else backend.robot.topology.site_body[index - bodies]
    point = data.xpos[index + 1] if index < bodies else data.site_xpos[index - bodies]
    shift, turn = mjx.jac(backend.model, data, point, body + 1)
    return jnp.concatenate([turn.T, shift.T])


def mass_matrix(backend: Backend, q: ArrayLike) -> Array:
    """Compute the joint-space inertia with armature, (nv, nv) kg m2.

    Args:
        backend: the robot.
        q: (nq,).

    Raises:
        InputError: a moving body has no inertia.
    """
    check_inertia(backend.robot)
    data = mjx.fwd_position(backend.model, _at(backend, q))
    return mjx.full_m(backend.model, data)


def bias_force(backend: Backend, q: ArrayLike, v: ArrayLike) -> Array:
    """Compute the Coriolis, centrifugal and gravity torque, (nv,) N m.

    Args:
        backend: the robot.
        q: (nq,).
        v: (nv,).

    Raises:
        InputError: a moving body has no inertia.
    """
    check_inertia(backend.robot)
    data = mjx.fwd_velocity(backend.model, mjx.fwd_position(backend.model, _at(backend, q, v)))
    return data.qfrc_bias


def step(backend: Backend, state: State, torque: ArrayLike) -> tuple[State, dict[str, Array]]:
    """Simulate one time step of the model.

    Args:
        backend: the robot.
        state: q and v.
        torque: (nv,) N m, applied at the joints.

    Returns:
        The next state, and what the model's sensors read at the given one.

    Raises:
        InputError: a moving body has no inertia.
    """
    check_inertia(backend.robot)
    data = _at(backend, state.q, state.v).replace(qfrc_applied=jnp.asarray(torque))
    after = mjx.step(backend.model, data)
    read = after.sensordata
    if backend.sensor_names:  # acceleration sensors stay zero where there is no constraint, unless called for
        read = mjx.sensor_acc(backend.model, mjx.forward(backend.model, data)).sensordata
    values = {n: read[a:b] for n, (a, b) in zip(backend.sensor_names, backend.sensor_slices, strict=True)}
    return State(after.qpos, after.qvel), values


def rollout(backend: Backend, state: State, torques: ArrayLike) -> Rollout:
    """Simulate under given joint torques.

    Args:
        backend: the robot; build it with `constraints=False` for reverse-mode gradients.
        state: where it starts.
        torques: (T, nv) N m, one row a step of the model's `timestep`.

    Returns:
        States and sensors after each step; batch over states and torques with `jax.vmap`.

    Raises:
        InputError: a moving body has no inertia.
    """

    def advance(state: State, torque: Array) -> tuple[State, Rollout]:
        state, sensors = step(backend, state, torque)
        return state, Rollout(state, sensors)

    return jax.lax.scan(advance, state, jnp.asarray(torques, state.q.dtype))[1]


__all__ = [
    "Backend",
    "Rollout",
    "State",
    "bias_force",
    "build",
    "forward",
    "jacobian",
    "jit",
    "mass_matrix",
    "rollout",
    "step",
]
