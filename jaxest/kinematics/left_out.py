"""What acts on a compiled model's joints beyond their own terms: what is taken along, and what is left out and said."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


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
        "springs and dampers that are not linear": int(sum(np.count_nonzero(x) for x in bent)),
    }
    found = [f"{count} {what}" for what, count in counts.items() if count]
    if model.opt.density > 0 or model.opt.viscosity > 0:
        found.append("air or water")
    return [f"left out: {'; '.join(found)}"] if found else []


__all__ = ["from_motors", "left_out"]
