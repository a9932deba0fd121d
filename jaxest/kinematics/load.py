"""Loading a robot from MJCF or URDF through MuJoCo, on the host; the mesh files it names may be absent."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxest.kinematics.compiled import compile_model, compiled
from jaxest.kinematics.left_out import from_motors, left_out, without_disabled
from jaxest.kinematics.robot import BALL, FREE, HINGE, NQ, SLIDE, Robot, Topology
from jaxest.types import InputError

if TYPE_CHECKING:
    import mujoco

_log = logging.getLogger("jaxest")
_KINDS = (FREE, BALL, SLIDE, HINGE)  # in the order of mjtJoint


def load(source: str | Path | mujoco.MjModel) -> Robot:
    """Load a robot.

    Hinge, slide, ball and free joints, several on a body, trees, fixed bodies (kept, also those of a URDF), sites and
    equality-coupled joints (URDF mimic joints among them). Meshes are read only where an inertia depends on them; what
    had to be left out is logged in one line and kept in `robot.notes`: constraints that close loops, tendons, gravity
    compensation. Motors' armature and damping are taken along to their joints; what option flags disable (gravity,
    springs, dampers, friction loss, equalities) is zero.

    Args:
        source: path of an MJCF or URDF file, its text, or a compiled model.

    Returns:
        The robot, its numbers as NumPy float64.

    Raises:
        FileNotFoundError: no such file.
        InputError: the file is no robot, or MuJoCo cannot compile it; the message names the file and the element.
        ValueError: the source is neither of these.
    """
    if not isinstance(source, (str, Path)):
        if not hasattr(source, "jnt_qposadr"):
            raise ValueError(f"source: got {type(source).__name__}, expected a path, MJCF or URDF text, or an MjModel")
        model = without_disabled(source)
        return _robot("model", model, (), tuple(left_out(model)))
    name, model, massless, notes = compiled(source)
    model = without_disabled(model)
    notes += left_out(model)
    for note in notes:
        _log.warning("%s: %s", name, note)
    try:
        return _robot(name, model, massless, tuple(notes))
    except UnicodeDecodeError as error:  # MuJoCo reads bytes, whatever the encoding
        raise InputError(f"{name}: a name is not UTF-8 text ({error.reason}); expected a file in UTF-8") from None


def _robot(source: str, model: mujoco.MjModel, massless: tuple[str, ...], notes: tuple[str, ...]) -> Robot:
    import mujoco

    objects = mujoco.mjtObj
    body_names = _names(model, objects.mjOBJ_BODY, "body", model.nbody)[1:]
    kinds = tuple(_KINDS[t] for t in model.jnt_type)
    couplings, coefficients = _couplings(source, model)
    topology = Topology(
        name=model.names[: model.names.index(b"\0")].decode(errors="replace") or "robot",
        body_names=body_names,
        body_parent=tuple(int(p) - 1 for p in model.body_parentid[1:]),
        joint_names=_names(model, objects.mjOBJ_JOINT, "joint", model.njnt),
        joint_kind=kinds,
        joint_body=tuple(int(b) - 1 for b in model.jnt_bodyid),
        joint_q=tuple(int(a) for a in model.jnt_qposadr),
        joint_v=tuple(int(a) for a in model.jnt_dofadr),
        site_names=_names(model, objects.mjOBJ_SITE, "site", model.nsite),
        site_body=tuple(int(b) - 1 for b in model.site_bodyid),
        couplings=couplings,
        massless=massless,
        notes=notes,
    )
    _check_finite(source, model, topology)
    mass = model.body_mass[1:].copy()
    inertia = _full_inertia(model)
    for index, body in enumerate(body_names):
        if body in massless:
            mass[index], inertia[index] = 0.0, 0.0
    return Robot(
        topology=topology,
        body_position=model.body_pos[1:].copy(),
        body_quaternion=model.body_quat[1:].copy(),
        body_mass=mass,
        body_com=model.body_ipos[1:].copy(),
        body_inertia=inertia,
        joint_anchor=model.jnt_pos.copy(),
        joint_axis=model.jnt_axis.copy(),
        joint_reference=model.qpos0.copy(),
        site_position=model.site_pos.copy(),
        site_quaternion=model.site_quat.copy(),
        coupling=coefficients,
        gravity=model.opt.gravity.copy(),
        armature=model.dof_armature + from_motors(model, getattr(model, "actuator_armature", np.zeros(model.nu))),
        damping=model.dof_damping + from_motors(model, getattr(model, "actuator_damping", np.zeros(model.nu))),
        friction_loss=model.dof_frictionloss.copy(),
        stiffness=model.jnt_stiffness.copy(),
        spring_reference=model.qpos_spring.copy(),
        home=_home(model),
        limits=_limits(model, topology, coefficients),
    )


def _check_finite(source: str, model: mujoco.MjModel, topology: Topology) -> None:
    """Refuse numbers that are not: MuJoCo only warns of them."""
    bodies, joints, sites = topology.body_names, topology.joint_names, topology.site_names
    body_numbers = (model.body_pos, model.body_quat, model.body_mass[:, None], model.body_ipos, model.body_inertia)
    for kind, names, numbers in (
        ("body", bodies, [x[1:] for x in body_numbers]),
        ("joint", joints, [model.jnt_pos, model.jnt_axis, model.jnt_range]),
        ("site", sites, [model.site_pos, model.site_quat]),
    ):
        for row, name in enumerate(names):
            if not all(np.isfinite(x[row]).all() for x in numbers):
                raise InputError(f"{source}: {kind} {name!r}: a number is NaN or infinite")


def _names(model: mujoco.MjModel, kind: Any, stem: str, count: int) -> tuple[str, ...]:
    """Return the names of all elements of a kind; nameless ones get the first free `stem` with a number."""
    import mujoco

    given = [mujoco.mj_id2name(model, kind, i) for i in range(count)]
    taken = set(given)
    names = []
    for index, name in enumerate(given):
        number = index
        while not name or (name != given[index] and name in taken):
            name, number = f"{stem}{number}", number + 1
        taken.add(name)
        names.append(name)
    return tuple(names)


def _full_inertia(model: mujoco.MjModel) -> np.ndarray:
    """Turn MuJoCo's principal inertias and their axes into matrices in the body's axes, (nb, 3, 3)."""
    import mujoco

    full = np.zeros((model.nbody - 1, 3, 3))
    for i in range(1, model.nbody):
        flat = np.zeros(9)
        mujoco.mju_quat2Mat(flat, model.body_iquat[i])
        rotation = flat.reshape(3, 3)
        full[i - 1] = rotation @ np.diag(model.body_inertia[i]) @ rotation.T
    return full


def _couplings(source: str, model: mujoco.MjModel) -> tuple[tuple[tuple[int, int], ...], np.ndarray]:
    """Collect active joint equalities, leaders before those that depend on them."""
    import mujoco

    waiting: dict[int, tuple[int, np.ndarray]] = {}
    for i in np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 > 0)):
        joint = int(model.eq_obj1id[i])
        if joint in waiting:
            name = model.joint(joint).name or f"number {joint}"
            raise InputError(
                f"{source}: equality: joint {name} is joint1 twice; expected once, swap joints in the other"
            )
        waiting[joint] = int(model.eq_obj2id[i]), model.eq_data[i, :5]
    ordered: list[tuple[int, int]] = []
    rows: list[np.ndarray] = []
    while waiting:
        ready = [joint for joint, (leader, _) in waiting.items() if leader not in waiting]
        if not ready:
            circle = ", ".join(model.joint(joint).name or f"number {joint}" for joint in sorted(waiting))
            raise InputError(f"{source}: equality: joints {circle} are coupled in a circle")
        for joint in ready:
            leader, coefficients = waiting.pop(joint)
            ordered.append((joint, leader))
            rows.append(coefficients.copy())
    return tuple(ordered), np.array(rows).reshape(-1, 5)


def _home(model: mujoco.MjModel) -> np.ndarray:
    import mujoco

    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    return (model.key_qpos[key] if key >= 0 else model.qpos0).copy()


def _limits(model: mujoco.MjModel, topology: Topology, coefficients: np.ndarray) -> np.ndarray:
    """Collect limits; those of joints that follow in proportion narrow their leader's, if that leaves a range."""
    limits = np.tile([-np.inf, np.inf], (model.nq, 1))
    for joint, kind in enumerate(topology.joint_kind):
        if model.jnt_limited[joint] and NQ[kind] == 1:
            limits[model.jnt_qposadr[joint]] = model.jnt_range[joint]
    for (joint, leader), (shift, slope, *bent) in reversed(list(zip(topology.couplings, coefficients, strict=True))):
        if leader < 0 or slope == 0 or any(bent):
            continue
        at, to = model.jnt_qposadr[joint], model.jnt_qposadr[leader]
        low, high = np.sort(model.qpos0[to] + (limits[at] - model.qpos0[at] - shift) / slope)
        low, high = max(low, limits[to, 0]), min(high, limits[to, 1])
        if low < high:
            limits[to] = low, high
    return limits


__all__ = ["compile_model", "load"]
