"""Leaving out of MuJoCo's editable model what a robot's kinematics and dynamics do not need, or what is absent."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


def name_bodies(spec: Any) -> None:
    """Give nameless bodies the first free `body` with a number from their own on."""
    taken = {body.name for body in spec.bodies}
    for number, body in enumerate(spec.bodies):
        while not body.name:
            if f"body{number}" not in taken:
                body.name = f"body{number}"
                taken.add(body.name)
            number += 1


def drop_meshes(spec: Any, folders: Sequence[Path] = ()) -> tuple[list[str], list[str]]:
    """Delete geoms that need a mesh or height-field file, but for present files that an inertia depends on.

    Args:
        spec: a `mujoco.MjSpec`; changed.
        folders: of the models that are attached to it, which their own files are relative to.

    Returns:
        Notes on absent files, and the names of bodies whose inertia an absent file would have given.
    """
    there = [Path(spec.modelfiledir or "."), *folders]
    absent = {mesh.name for mesh in spec.meshes if mesh.file and not _exists(there, spec, mesh)}
    absent_fields = {field.name for field in spec.hfields if field.file and not _exists(there, spec, field)}
    missing = {mesh.file for mesh in spec.meshes if mesh.name in absent}
    missing |= {field.file for field in spec.hfields if field.name in absent_fields}
    massless: list[str] = []
    dropped: list[str] = []
    kept: set[str] = set()
    for body in spec.bodies:
        for geom in list(body.geoms):
            if not geom.meshname and geom.hfieldname not in absent_fields:
                continue
            weighs = geom.meshname and gives_inertia(spec, body, geom)
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


def _exists(folders: Sequence[Path], spec: Any, asset: Any) -> bool:
    subs = {"", spec.meshdir or "", spec.compiler.meshdir or "", asset.compiler.meshdir or ""}
    return any((folder / sub / asset.file).is_file() for folder in folders for sub in subs)


def gives_inertia(spec: Any, body: Any, geom: Any) -> bool:
    """Tell whether a geom counts for its body's inertia, as MuJoCo's compiler decides it.

    Args:
        spec: a `mujoco.MjSpec`.
        body: of it.
        geom: of the body.

    Returns:
        Whether it does.
    """
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
