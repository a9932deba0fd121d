"""How `inspect` shows a robot: a tree of bodies, joints and sites for people, the same as plain data for programs."""

import math
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from rich.tree import Tree

from jaxest.cli.tables import grid, number
from jaxest.kinematics.robot import NQ

UNITS = {"hinge": "rad", "slide": "m"}


def describe(robot: Any) -> dict[str, Any]:
    """Return a robot's structure as data that JSON can hold.

    Args:
        robot: a `jaxest.kinematics.Robot`.

    Returns:
        Sizes, bodies, joints (kind, body, axis, limits; null where there is no limit), frames, couplings, notes.
    """
    topology = robot.topology
    parents = ["world" if p < 0 else topology.body_names[p] for p in topology.body_parent]
    masses = np.asarray(robot.body_mass, float)
    return {
        "name": topology.name,
        "nq": robot.nq,
        "nv": robot.nv,
        "mass_kg": float(masses.sum()),
        "bodies": [
            {"name": name, "parent": parent, "mass_kg": float(mass)}
            for name, parent, mass in zip(topology.body_names, parents, masses, strict=True)
        ],
        "joints": [_joint(robot, index) for index in range(len(topology.joint_names))],
        "frames": list(robot.frame_names),
        "couplings": [
            {
                "joint": topology.joint_names[joint],
                "follows": topology.joint_names[leader] if leader >= 0 else None,
                "polynomial": np.asarray(robot.coupling[i], float).tolist(),
            }
            for i, (joint, leader) in enumerate(topology.couplings)
        ],
        "massless": list(topology.massless),
        "notes": list(robot.notes),
    }


def _joint(robot: Any, index: int) -> dict[str, Any]:
    topology = robot.topology
    kind, at = topology.joint_kind[index], topology.joint_q[index]
    simple = kind in UNITS
    ends = np.asarray(robot.limits[at], float).tolist() if simple else [math.inf, math.inf]
    return {
        "name": topology.joint_names[index],
        "kind": kind,
        "body": topology.body_names[topology.joint_body[index]],
        "q": at,
        "v": topology.joint_v[index],
        "axis": np.asarray(robot.joint_axis[index], float).tolist() if simple else None,
        "limits": [end if math.isfinite(end) else None for end in ends],
        "unit": UNITS.get(kind),
        "home": np.asarray(robot.home[at : at + NQ[kind]], float).tolist(),
    }


def show(facts: dict[str, Any], sites: dict[str, list[str]], out: Console) -> None:
    """Print the tree of bodies, the table of joints and what was left out.

    Args:
        facts: from `describe`.
        sites: names of the sites on each body, `world` included; from `sites_of`.
        out: where to.
    """
    joints: dict[str, list[str]] = {}
    for joint in facts["joints"]:
        joints.setdefault(joint["body"], []).append(f"[cyan]{joint['kind']}[/] {escape(joint['name'])}")
    size = f"{facts['nq']} coordinates, {facts['nv']} velocities, {number(facts['mass_kg'])} kg"
    root = Tree(f"[bold]{escape(facts['name'])}[/]  [dim]{size}[/]", guide_style="dim")
    branches = {"world": root}
    _add_sites(root, sites.get("world", []))
    for body in facts["bodies"]:
        name = body["name"]
        label = (
            f"[bold]{escape(name)}[/]  {', '.join(joints[name])}"
            if name in joints
            else f"{escape(name)}  [dim]fixed[/]"
        )
        branches[name] = branches[body["parent"]].add(label)
        _add_sites(branches[name], sites.get(name, []))
    out.print(root)
    if facts["joints"]:
        out.print()
        out.print(_joints(facts))
    for line in facts["notes"]:
        out.print(f"[yellow]note:[/] {escape(line)}", soft_wrap=True)


def _add_sites(branch: Tree, names: list[str]) -> None:
    if names:
        branch.add("[magenta]" + "  ".join(f"site:{escape(name)}" for name in names) + "[/]")


def _joints(facts: dict[str, Any]) -> Table:
    leaders = {one["joint"]: one["follows"] or "a constant" for one in facts["couplings"]}
    lines = []
    for joint in facts["joints"]:
        axis, limits = "", ""
        if joint["axis"]:
            axis = " ".join(number(part) for part in np.round(joint["axis"], 6) + 0.0)
            low, high = joint["limits"]
            limits = "none" if low is high is None else f"{number(low, 4)} .. {number(high, 4)} {joint['unit']}"
        home = " ".join(number(part) for part in joint["home"])
        lines.append(
            (str(joint["q"]), joint["name"], joint["kind"], axis, limits, home, leaders.get(joint["name"], ""))
        )
    headers = ("q", "joint", "kind", "axis", "limits", "home", "follows")
    kept = [i for i, header in enumerate(headers) if header != "follows" or leaders]
    return grid([headers[i] for i in kept], [[line[i] for i in kept] for line in lines], right=(0,))


def sites_of(robot: Any) -> dict[str, list[str]]:
    """Return the names of the sites on each body, the world included.

    Args:
        robot: a `jaxest.kinematics.Robot`.

    Returns:
        Names of sites by name of body.
    """
    topology = robot.topology
    found: dict[str, list[str]] = {}
    for name, body in zip(topology.site_names, topology.site_body, strict=True):
        found.setdefault("world" if body < 0 else topology.body_names[body], []).append(name)
    return found
