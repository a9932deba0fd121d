"""What acts on a compiled model's joints beyond their own terms: what is taken along, and what is left out and said."""

import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLAGS = {
    "GRAVITY": ("body_gravcomp",),
    "SPRING": ("jnt_stiffness", "jnt_stiffnesspoly", "tendon_stiffness"),
    "DAMPER": ("dof_damping", "dof_dampingpoly", "tendon_damping", "actuator_damping"),
    "EQUALITY": ("eq_active0",),
    "FRICTIONLOSS": ("dof_frictionloss",),
    "CONSTRAINT": ("eq_active0", "dof_frictionloss"),
}
"""What a file's `<option><flag NAME="disable"/>` switches off, by name of `mjtDisableBit`."""


def without_disabled(model: Any) -> Any:
    """Return a model in which what its option flags switch off is zero; limits stay, as a robot has them anyway.

    Args:
        model: a `mujoco.MjModel`.

    Returns:
        The same, or a changed copy.
    """
    import mujoco

    off = [name for name in FLAGS if model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))]
    if not off:
        return model
    model = copy.copy(model)
    for field in [field for name in off for field in FLAGS[name] if hasattr(model, field)]:
        getattr(model, field)[...] = 0
    if "GRAVITY" in off:
        model.opt.gravity[:] = 0
    return model


def from_motors(model: Any, per_motor: Any) -> NDArray[np.float64]:
    """Return what motors on hinges and slides add to the joints' armature or damping.

    Args:
        model: a `mujoco.MjModel`.
        per_motor: (nu,) armature or damping on the motors' side.

    Returns:
        (nv,) the same at the joints: times the square of the gear.
    """
    import mujoco

    found = np.zeros(model.nv)
    on_joint = [int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    single = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    for motor in range(model.nu):
        joint = model.actuator_trnid[motor, 0]
        if model.actuator_trntype[motor] in on_joint and model.jnt_type[joint] in single:
            found[model.jnt_dofadr[joint]] += per_motor[motor] * model.actuator_gear[motor, 0] ** 2
    return found


def left_out(model: Any) -> list[str]:
    """Say what MuJoCo lets act on a robot and kinematics and dynamics here do not know.

    Args:
        model: a `mujoco.MjModel`.

    Returns:
        One line, or none.
    """
    import mujoco

    joint = int(mujoco.mjtEq.mjEQ_JOINT)
    closing = [mujoco.mjtEq(t).name[5:].lower() for t in model.eq_type[model.eq_active0 > 0] if t != joint]
    pulls = [np.asarray(getattr(model, f"tendon_{name}")) for name in ("stiffness", "damping", "armature")]
    bent = [np.asarray(getattr(model, name, 0)) for name in ("dof_dampingpoly", "jnt_stiffnesspoly")]
    counts = {
        f"constraints ({', '.join(sorted(set(closing)))}), so that closed loops are open": len(closing),
        "tendons' springs, dampers and inertias": int(sum(np.count_nonzero(x) for x in pulls)),
        "bodies' gravity compensation": int(np.count_nonzero(model.body_gravcomp)),
        "limits of ball joints": int(np.count_nonzero(model.jnt_limited[model.jnt_type == mujoco.mjtJoint.mjJNT_BALL])),
        "springs and dampers that are not linear": int(sum(np.count_nonzero(x) for x in bent)),
    }
    found = [f"{count} {what}" for what, count in counts.items() if count]
    if model.opt.density > 0 or model.opt.viscosity > 0:
        found.append("air or water")
    return [f"left out: {'; '.join(found)}"] if found else []


__all__ = ["from_motors", "left_out", "without_disabled"]
