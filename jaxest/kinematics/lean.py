"""Leaving out of MuJoCo's editable model what a robot's kinematics and dynamics do not need, or what is absent."""

from pathlib import Path
from typing import Any

import numpy as np


def drop_meshes(spec: Any) -> tuple[list[str], list[str]]:
    """Delete geoms that need a mesh or height-field file, but for present files that an inertia depends on.

    Args:
        spec: a `mujoco.MjSpec`; changed.

    Returns:
        Notes on absent files, and the names of bodies whose inertia an absent file would have given.
    """
    folder = Path(spec.modelfiledir or ".")
    absent = {mesh.name for mesh in spec.meshes if mesh.file and not _exists(folder, spec, mesh.file)}
    absent_fields = {field.name for field in spec.hfields if field.file and not _exists(folder, spec, field.file)}
    missing = {mesh.file for mesh in spec.meshes if mesh.name in absent}
    missing |= {field.file for field in spec.hfields if field.name in absent_fields}
    massless: list[str] = []
    dropped: list[str] = []
    kept: set[str] = set()
    for body in spec.bodies:
        for geom in list(body.geoms):
            if not geom.meshname and geom.hfieldname not in absent_fields:
                continue
            weighs = geom.meshname and _gives_inertia(spec, body, geom)
            if weighs and geom.meshname not in absent:
                kept.add(geom.meshname)
                continue
            if weighs and body.name not in massless:
                massless.append(body.name)
            dropped.append(geom.name)  # a sensor's object of another type with this name goes too; nobody misses it
            spec.delete(geom)
    for mesh in list(spec.meshes):
        if mesh.name not in kept:
            spec.delete(mesh)
    for field in list(spec.hfields):
        if field.name in absent_fields:
            spec.delete(field)
    for pair in list(spec.pairs):
        if {pair.geomname1, pair.geomname2} & set(dropped):
            spec.delete(pair)
    for sensor in list(spec.sensors):
        if {sensor.objname, sensor.refname} & set(dropped) - {""}:
            spec.delete(sensor)
    for body in spec.bodies:
        if body.name in massless:
            give_unit_inertia(body)
    notes = [f"{len(missing)} mesh files absent, geometry left out (first: {min(missing)})"] if missing else []
    return notes, massless


def _exists(folder: Path, spec: Any, file: str) -> bool:
    return any((folder / sub / file).is_file() for sub in ("", spec.meshdir or "", spec.compiler.meshdir or ""))


def _gives_inertia(spec: Any, body: Any, geom: Any) -> bool:
    """Tell whether a geom counts for its body's inertia, as MuJoCo's compiler decides it."""
    import mujoco

    if body.name == "world" or geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0):
        return False
    low, high = spec.compiler.inertiagrouprange
    mode = spec.compiler.inertiafromgeom
    from_geom = mode == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE or not body.explicitinertial
    return bool(low <= geom.group <= high and from_geom and mode != mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE)


def give_unit_inertia(body: Any) -> None:
    """Let a body compile whose inertia is unknown."""
    body.explicitinertial = True
    body.mass = 1.0
    body.ipos = (0, 0, 0)
    body.inertia = (1, 1, 1)


def drop_decoration(spec: Any) -> None:
    """Delete what only pictures need and what may name files that are absent."""
    for material in list(spec.materials):
        material.textures = [""] * len(material.textures)
    for group in (spec.textures, spec.skins):
        for element in list(group):
            spec.delete(element)
