"""A robot's file compiled by MuJoCo, with what kinematics and dynamics do not need left out and fixed bodies kept."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxest.kinematics.given_inertia import put_back, set_aside, weightless
from jaxest.kinematics.includes import check_includes
from jaxest.kinematics.lean import drop_decoration, drop_meshes, give_unit_inertia, name_bodies
from jaxest.kinematics.urdf import check_text, check_urdf
from jaxest.types import InputError

if TYPE_CHECKING:
    import mujoco


class Compiled(NamedTuple):
    """What came of a file."""

    name: str
    """Of the file, for messages."""
    model: mujoco.MjModel
    massless: tuple[str, ...]
    """Moving bodies without inertia; they have a stand-in of 1 kg."""
    notes: list[str]
    """What was left out or is odd, a line each."""


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
    return compiled(source).model


def compiled(source: str | Path) -> Compiled:
    """Compile what kinematics and dynamics need.

    Args:
        source: path of an MJCF or URDF file, or its text.

    Returns:
        The model, and what is to be said of it.

    Raises:
        FileNotFoundError: no such file.
        InputError: the file is no robot, or MuJoCo cannot compile it.
    """
    import mujoco

    with _heard() as heard:
        name, spec, told, folders = _read(source)
        spec.compiler.fusestatic = False
        total, spec.compiler.settotalmass = spec.compiler.settotalmass, -1  # stand-ins would count
        name_bodies(spec)
        notes, massless = drop_meshes(spec, folders)
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
    if total > 0:
        mujoco.mj_setTotalmass(model, total)
    massless += weightless(model)
    odd, massless = (  # a fixed body's weight does not matter
        [body for body in group if model.body_weldid[model.body(body).id] != 0] for group in (given, massless)
    )
    if odd:
        notes.append(f"{len(odd)} inertias that no matter has, used as given ({_some(odd)})")
    if massless:
        notes.append(f"kinematics only: no inertia for {len(massless)} bodies ({_some(massless)})")
    return Compiled(name, model, tuple(massless), notes)


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


def _read(source: str | Path) -> tuple[str, Any, list[str], list[Path]]:
    """Parse a file or a text; return a name for messages, MuJoCo's editable model, notes, and its parts' folders."""
    import mujoco

    name, inline, text = _text(source)
    check_text(name, text)
    check_urdf(name, text)
    notes, folders = check_includes(name, text, Path() if inline else Path(name).parent)
    try:
        spec = mujoco.MjSpec.from_string(text) if inline else mujoco.MjSpec.from_file(name)
    except ValueError as error:
        raise InputError(f"{name}: MuJoCo cannot read it: {_one_line(error)}") from None
    try:
        _ = [part.name for group in (spec.bodies, spec.joints, spec.sites, spec.geoms) for part in group]
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: a name is not UTF-8 ({error.object!r}); save the file as UTF-8") from None
    return name, spec, notes, folders


def _one_line(error: Exception | Warning | str) -> str:
    return "; ".join(part.strip() for part in str(error).splitlines() if part.strip())


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")


def _refusal(name: str, error: Exception) -> InputError:
    hint = (
        "; call the link that it hangs on 'world'" if "free joint can only be used on top level" in str(error) else ""
    )
    return InputError(f"{name}: MuJoCo cannot compile it: {_one_line(error)}{hint}")


__all__ = ["Compiled", "compile_model", "compiled"]
