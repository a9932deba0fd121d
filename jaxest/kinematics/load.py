"""Loading a robot from MJCF or URDF through MuJoCo, on the host; the mesh files it names may be absent."""

from __future__ import annotations

import contextlib
import logging
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxest.kinematics.given_inertia import put_back, set_aside, weightless
from jaxest.kinematics.includes import check_includes
from jaxest.kinematics.lean import drop_decoration, drop_meshes, give_unit_inertia
from jaxest.kinematics.robot import BALL, FREE, HINGE, NQ, SLIDE, Robot, Topology
from jaxest.kinematics.urdf import check_text, check_urdf
from jaxest.types import InputError

if TYPE_CHECKING:
    import mujoco

_log = logging.getLogger("jaxest")
_KINDS = (FREE, BALL, SLIDE, HINGE)  # in the order of mjtJoint


def load(source: str | Path | mujoco.MjModel) -> Robot:
    """Load a robot.

    Hinge, slide, ball and free joints, several on a body, trees, fixed bodies (kept, also those of a URDF), sites and
    equality-coupled joints (URDF mimic joints among them). Meshes are read only where an inertia depends on them; what
    had to be left out is logged in one line and kept in `robot.notes`.

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
        return _robot("model", source, (), ())
    name, model, massless, notes = _compile(source)
    for note in notes:
        _log.warning("%s: %s", name, note)
    try:
        return _robot(name, model, massless, tuple(notes))
    except UnicodeDecodeError as error:  # MuJoCo reads bytes, whatever the encoding
        raise InputError(f"{name}: a name is not UTF-8 text ({error.reason}); expected a file in UTF-8") from None


def compile_model(source: str | Path) -> mujoco.MjModel:
    """Compile the same file for MuJoCo's own functions, with the same things left out and fixed bodies kept.

    Args:
        source: path of an MJCF or URDF file, or its text.

    Returns:
        MuJoCo's model; bodies without inertia have a stand-in of 1 kg.

    Raises:
        FileNotFoundError: no such file.
        InputError: the file is no robot, or MuJoCo cannot compile it.
    """
    return _compile(source)[1]


@contextlib.contextmanager
def _heard() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which it would print, and write into a file of the working folder."""
    import mujoco

    heard: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(heard.append)
    try:
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            yield heard
        heard += [_one_line(entry.message) for entry in found]
    finally:
        mujoco.set_mju_user_warning(before)


def _text(source: str | Path) -> tuple[str, bool, str]:
    """Return a name for messages, whether the source is the text itself, and the text."""
    text = str(source).removeprefix("\ufeff")
    if isinstance(source, str) and text.lstrip().startswith("<"):
        return "robot text", True, text
    try:
        there = Path(source).is_file()
    except (OSError, ValueError):  # a name that no file can have
        there = False
    if not there:
        shown = text if len(text) < 200 else f"{text[:200]}..."
        raise FileNotFoundError(f"{shown}: no such file; expected an MJCF or URDF robot")
    return text, False, Path(source).read_text(encoding="utf-8", errors="replace")


def _read(source: str | Path) -> tuple[str, Any, list[str]]:
    """Parse a file or a text; return a name for messages, MuJoCo's editable model, and notes."""
    import mujoco

    name, inline, text = _text(source)
    check_text(name, text)
    check_urdf(name, text)
    notes = check_includes(name, text, Path() if inline else Path(name).parent)
    try:
        spec = mujoco.MjSpec.from_string(text) if inline else mujoco.MjSpec.from_file(name)
    except ValueError as error:
        raise InputError(f"{name}: MuJoCo cannot read it: {_one_line(error)}") from None
    try:
        _ = [part.name for group in (spec.bodies, spec.joints, spec.sites, spec.geoms) for part in group]
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: a name is not UTF-8 ({error.object!r}); save the file as UTF-8") from None
    return name, spec, notes


def _one_line(error: Exception | Warning | str) -> str:
    return "; ".join(part.strip() for part in str(error).splitlines() if part.strip())


def _compile(source: str | Path) -> tuple[str, mujoco.MjModel, tuple[str, ...], list[str]]:
    """Compile what kinematics and dynamics need; return a name, the model, the bodies without inertia, and notes."""
    with _heard() as heard:
        name, spec, told = _read(source)
        spec.compiler.fusestatic = False
        notes, massless = drop_meshes(spec)
        drop_decoration(spec)
        empty = [body for body in spec.bodies if body.joints and not body.explicitinertial and not body.geoms]
        given = set_aside(spec)
        try:
            model = spec.compile()
        except ValueError as error:
            if "mass and inertia of moving bodies" not in str(error):
                raise _refusal(name, error) from None
            for body in empty:
                give_unit_inertia(body)
            massless += [body.name for body in empty]
            try:
                model = spec.compile()
            except ValueError as second:
                raise _refusal(name, second) from None
    notes += [*told, *dict.fromkeys(_one_line(line) for line in heard)]
    put_back(model, given)
    massless += weightless(model, given)
    odd, massless = (  # a fixed body's weight does not matter
        [body for body in group if model.body_weldid[model.body(body).id] != 0] for group in (given, massless)
    )
    if odd:
        notes.append(f"{len(odd)} inertias that no matter has, used as given ({_some(odd)})")
    if massless:
        notes.append(f"kinematics only: no inertia for {len(massless)} bodies ({_some(massless)})")
    return name, model, tuple(massless), notes


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")


def _refusal(name: str, error: Exception) -> InputError:
    hint = (
        "; call the link that it hangs on 'world'" if "free joint can only be used on top level" in str(error) else ""
    )
    return InputError(f"{name}: MuJoCo cannot compile it: {_one_line(error)}{hint}")


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
        armature=model.dof_armature.copy(),
        damping=model.dof_damping.copy(),
        friction_loss=model.dof_frictionloss.copy(),
        stiffness=model.jnt_stiffness.copy(),
        spring_reference=model.qpos_spring.copy(),
        home=_home(model),
        limits=_limits(model, kinds),
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

    waiting = {
        int(model.eq_obj1id[i]): (int(model.eq_obj2id[i]), model.eq_data[i, :5])
        for i in range(model.neq)
        if model.eq_type[i] == mujoco.mjtEq.mjEQ_JOINT and model.eq_active0[i]
    }
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


def _limits(model: mujoco.MjModel, kinds: tuple[str, ...]) -> np.ndarray:
    limits = np.tile([-np.inf, np.inf], (model.nq, 1))
    for joint, kind in enumerate(kinds):
        if model.jnt_limited[joint] and NQ[kind] == 1:
            limits[model.jnt_qposadr[joint]] = model.jnt_range[joint]
    return limits
