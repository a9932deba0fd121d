"""Inertias that MuJoCo refuses, as files of real robots hold them: compiled with stand-ins, then put back as given.

Rounding by a design program makes A + B < C or an eigenvalue of zero; a link that only carries a frame weighs nothing.
Kinematics do not care, and dynamics mean what the file says, as other libraries take it.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxest.kinematics.lean import give_unit_inertia, gives_inertia


class Given(NamedTuple):
    """What a file says of a body's mass, raised to the compiler's bounds."""

    mass: float
    position: np.ndarray
    """(3,) m, centre of mass."""
    principal: np.ndarray
    """(3,) kg m2."""
    axes: np.ndarray
    """(4,) wxyz, from the principal axes to those in which the file gives the inertia."""

    @property
    def physical(self) -> bool:
        """Whether a body of matter can have it."""
        low, middle, high = np.sort(self.principal)
        return bool(self.mass > 0 and low > 0 and low + middle >= high * (1 - 1e-9))


def set_aside(spec: Any) -> dict[str, Given]:
    """Give stand-ins to the bodies whose inertia MuJoCo would refuse.

    Args:
        spec: a `mujoco.MjSpec`; changed.

    Returns:
        What the file says of them, by name of the body.
    """
    import mujoco

    found: dict[str, Given] = {}
    for body in spec.bodies:
        if not body.explicitinertial or body.name == "world":
            continue
        principal, axes = np.array(body.inertia, float), np.array([1.0, 0, 0, 0])
        full = np.array(body.fullinertia, float)
        if np.isfinite(full).all():
            xx, yy, zz, xy, xz, yz = full
            principal, turn = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            turn[:, 2] *= np.sign(np.linalg.det(turn))
            mujoco.mju_mat2Quat(axes, turn.flatten())
        mass, principal = max(body.mass, spec.compiler.boundmass), np.maximum(principal, spec.compiler.boundinertia)
        given = Given(float(mass), np.array(body.ipos, float), principal, axes)
        if given.physical or not np.isfinite([given.mass, *principal]).all() or _replaced(spec, body, given):
            continue
        found[body.name] = given
        give_unit_inertia(body)
        body.fullinertia = np.full(6, np.nan)
    return found


def _replaced(spec: Any, body: Any, given: Given) -> bool:
    """Tell whether the compiler is told to put something else in the place of such an inertia."""
    if spec.compiler.balanceinertia and given.mass > 0 and given.principal.min() > 0:
        return True
    return any(gives_inertia(spec, body, geom) for geom in body.geoms)


def put_back(model: Any, given: dict[str, Given]) -> None:
    """Write what the file says into a compiled model.

    Args:
        model: a `mujoco.MjModel`; changed.
        given: what `set_aside` took.
    """
    import mujoco

    for name, own in given.items():
        body = model.body(name).id
        model.body_mass[body], model.body_ipos[body] = own.mass, own.position
        model.body_inertia[body] = own.principal
        turned = np.zeros(4)
        mujoco.mju_mulQuat(turned, model.body_iquat[body], own.axes)
        model.body_iquat[body] = turned


def weightless(model: Any) -> list[str]:
    """Name the bodies whose joint would move nothing: neither they nor what hangs on them weighs anything.

    A frame without mass that is fixed to a link, as many robots have at their tips, is none of them.

    Args:
        model: the compiled model, with what was given put back.

    Returns:
        Names.
    """
    carried = np.array(model.body_mass)
    for body in range(model.nbody - 1, 0, -1):
        carried[model.body_parentid[body]] += carried[body]
    return [model.body(body).name for body in np.flatnonzero((carried <= 0) & (model.body_jntnum > 0))]


__all__ = ["Given", "put_back", "set_aside", "weightless"]
