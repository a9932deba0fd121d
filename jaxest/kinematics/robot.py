"""The robot as a pytree: numbers that can be differentiated, batched and tuned, and a static topology."""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.types import Array, ArrayLike, unknown_name

Leaf = Array | np.ndarray

HINGE, SLIDE, BALL, FREE = "hinge", "slide", "ball", "free"
NQ = {HINGE: 1, SLIDE: 1, BALL: 4, FREE: 7}
NV = {HINGE: 1, SLIDE: 1, BALL: 3, FREE: 6}


@dataclasses.dataclass(frozen=True)
class Topology:
    """What is static in a robot: who hangs on whom, by which joint, under which name. Bodies do not count the world."""

    name: str
    body_names: tuple[str, ...]
    body_parent: tuple[int, ...]
    """Parent of each body, -1 for the world; parents come first."""
    joint_names: tuple[str, ...]
    joint_kind: tuple[str, ...]
    joint_body: tuple[int, ...]
    joint_q: tuple[int, ...]
    """Address of each joint's first coordinate in q."""
    joint_v: tuple[int, ...]
    """Address of each joint's first coordinate in v."""
    site_names: tuple[str, ...]
    site_body: tuple[int, ...]
    """Body of each site, -1 for the world."""
    couplings: tuple[tuple[int, int], ...]
    """(dependent joint, leading joint or -1 for a constant), in an order that can be evaluated."""
    massless: tuple[str, ...]
    """Moving bodies whose inertia is unknown."""
    notes: tuple[str, ...]
    """What was left out on loading, a line each."""

    @functools.cached_property
    def frame_names(self) -> tuple[str, ...]:
        """Bodies by name, then sites as `site:NAME`."""
        return self.body_names + tuple(f"site:{name}" for name in self.site_names)

    @functools.cached_property
    def nq(self) -> int:
        """Number of coordinates."""
        return sum(NQ[kind] for kind in self.joint_kind)

    @functools.cached_property
    def nv(self) -> int:
        """Number of velocities."""
        return sum(NV[kind] for kind in self.joint_kind)

    @functools.cached_property
    def free(self) -> tuple[int, ...]:
        """Coordinates that no coupling determines, as indices into q."""
        dependent = {self.joint_q[joint] for joint, _ in self.couplings}
        return tuple(i for i in range(self.nq) if i not in dependent)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Robot:
    """A robot loaded from MJCF or URDF by `jaxest.kinematics.load`; order and conventions are MuJoCo's.

    All numeric fields are leaves (SI units, nb bodies without the world, nj joints, ns sites): differentiate them,
    batch them with `vmap`, change them with `with_parameters`.
    """

    topology: Topology = dataclasses.field(metadata={"static": True})
    body_position: Leaf
    """(nb, 3) m, origin of the body in its parent, before its joints move."""
    body_quaternion: Leaf
    """(nb, 4) wxyz, body to parent."""
    body_mass: Leaf
    """(nb,) kg."""
    body_com: Leaf
    """(nb, 3) m, centre of mass in the body."""
    body_inertia: Leaf
    """(nb, 3, 3) kg m2, about the centre of mass, in the body's axes."""
    joint_anchor: Leaf
    """(nj, 3) m, a point on the joint's axis, in its body."""
    joint_axis: Leaf
    """(nj, 3), in its body; normalised on use."""
    joint_reference: Leaf
    """(nq,) coordinates at which the bodies stand as `body_position` says."""
    site_position: Leaf
    """(ns, 3) m, in the site's body."""
    site_quaternion: Leaf
    """(ns, 4) wxyz, site to body."""
    coupling: Leaf
    """(nc, 5) polynomial coefficients of the coupled joints, in offsets from `joint_reference`."""
    gravity: Leaf
    """(3,) m/s2, in the world."""
    armature: Leaf
    """(nv,) kg m2 (kg for slides), inertia of rotors at the joint, added to the mass matrix."""
    damping: Leaf
    """(nv,) N m s (N s/m for slides)."""
    friction_loss: Leaf
    """(nv,) N m (N for slides)."""
    stiffness: Leaf
    """(nj,) N m/rad (N/m for slides)."""
    spring_reference: Leaf
    """(nq,) coordinates at which the springs are at rest."""
    home: Leaf
    """(nq,) keyframe `home` if the file has one, else `joint_reference`."""
    limits: Leaf
    """(nq, 2) rad or m, infinite where there is none; a leader's hold for what follows it in proportion, too."""

    @property
    def nq(self) -> int:
        """Number of coordinates."""
        return self.topology.nq

    @property
    def nv(self) -> int:
        """Number of velocities."""
        return self.topology.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joints, in the order of q."""
        return self.topology.joint_names

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Every body but the world by its name, then sites as `site:NAME`."""
        return self.topology.frame_names

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out on loading, a line each."""
        return self.topology.notes


def frame(robot: Robot, name: str) -> int:
    """Return the index of a frame in the order of `forward`.

    Args:
        robot: the robot.
        name: a body's name, or `site:NAME`.

    Returns:
        The index in `robot.frame_names`.

    Raises:
        InputError: no frame has this name; the closest ones are named.
    """
    try:
        return robot.frame_names.index(name)
    except ValueError:
        raise unknown_name("frame", name, robot.frame_names) from None


def expand(robot: Robot, free: ArrayLike) -> Array:
    """Fill in the coordinates that equality constraints couple to others.

    Args:
        robot: the robot.
        free: (n_free,) the coordinates of `robot.topology.free`, in the order of q; rad or m.

    Returns:
        q, (nq,): each coupled joint at its reference plus the polynomial of its leader's offset from its reference.

    Raises:
        ValueError: the shape of `free` is wrong.
    """
    topology = robot.topology
    free = jnp.asarray(free)
    if free.shape != (len(topology.free),):
        raise ValueError(f"free: shape {free.shape}, expected ({len(topology.free)},)")
    reference = jnp.asarray(robot.joint_reference, free.dtype)
    q = jnp.zeros((topology.nq,), free.dtype).at[np.array(topology.free, int)].set(free)
    for (joint, leader), coefficients in zip(topology.couplings, robot.coupling, strict=True):
        at = topology.joint_q[joint]
        x = jnp.zeros((), free.dtype)
        if leader >= 0:
            x = q[topology.joint_q[leader]] - reference[topology.joint_q[leader]]
        value = jnp.polyval(jnp.asarray(coefficients, free.dtype)[::-1], x)
        q = q.at[at].set(reference[at] + value)
    return q


def is_concrete(*leaves: Any) -> bool:
    """Tell whether values are known now, so that they can be folded on the host."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)


def _set(leaf: Any, index: int, value: ArrayLike, place: str = "value") -> Any:
    if np.shape(value) != leaf.shape[1:]:
        raise ValueError(f"{place}: shape {np.shape(value)}, expected {leaf.shape[1:]}")
    if is_concrete(leaf, value):
        changed = np.array(leaf)
        changed[index] = value
        return changed
    return jnp.asarray(leaf).at[index].set(value)


def with_parameters(
    robot: Robot,
    *,
    position: Mapping[str, ArrayLike] | None = None,
    quaternion: Mapping[str, ArrayLike] | None = None,
    mass: Mapping[str, ArrayLike] | None = None,
    center_of_mass: Mapping[str, ArrayLike] | None = None,
    payload: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
) -> Robot:
    """Return a robot with some numbers changed; values may be traced, so they can be tuned and differentiated.

    Args:
        robot: the robot.
        position: frame name -> (3,) m, origin of a body in its parent, or of a site (`site:NAME`) in its body.
        quaternion: frame name -> (4,) wxyz, body to parent or site to body.
        mass: body name -> () kg.
        center_of_mass: body name -> (3,) m in the body.
        payload: body name -> (mass () kg, position (3,) m in the body) of a point mass attached to it.

    Returns:
        The changed robot; the given one stays as it is.

    Raises:
        InputError: no such frame or body.
        ValueError: a value has another shape.
    """
    bodies = len(robot.topology.body_names)
    changed: dict[str, Any] = {}

    def change(field: str, index: int, value: ArrayLike, place: str) -> None:
        changed[field] = _set(changed.get(field, getattr(robot, field)), index, value, place)

    def body(name: str) -> int:
        if name not in robot.topology.body_names:
            raise unknown_name("body", name, robot.topology.body_names)
        return robot.topology.body_names.index(name)

    for quantity, values in (("position", position), ("quaternion", quaternion)):
        for name, value in (values or {}).items():
            index = frame(robot, name)
            owner, index = ("body", index) if index < bodies else ("site", index - bodies)
            change(f"{owner}_{quantity}", index, value, f"{quantity}[{name!r}]")
    for name, value in (mass or {}).items():
        change("body_mass", body(name), value, f"mass[{name!r}]")
    for name, value in (center_of_mass or {}).items():
        change("body_com", body(name), value, f"center_of_mass[{name!r}]")
    robot = dataclasses.replace(robot, **changed)
    for name, (point_mass, point) in (payload or {}).items():
        if np.shape(point_mass) != () or np.shape(point) != (3,):
            raise ValueError(
                f"payload[{name!r}]: shapes {np.shape(point_mass)} and {np.shape(point)}, expected () and (3,)"
            )
        robot = _attach(robot, body(name), point_mass, point)
    return robot


def _attach(robot: Robot, body: int, point_mass: ArrayLike, point: ArrayLike) -> Robot:
    """Add a point mass to a body: mass, centre and inertia by the parallel-axis theorem."""
    xp: Any = np if is_concrete(robot.body_mass, robot.body_com, robot.body_inertia, point_mass, point) else jnp
    own, com = robot.body_mass[body], xp.asarray(robot.body_com[body])
    total = own + point_mass
    arm = xp.asarray(point) - com
    reduced = own * point_mass / total
    spread = reduced * (xp.dot(arm, arm) * xp.eye(3) - xp.outer(arm, arm))
    return dataclasses.replace(
        robot,
        body_mass=_set(robot.body_mass, body, total),
        body_com=_set(robot.body_com, body, com + arm * (point_mass / total)),
        body_inertia=_set(robot.body_inertia, body, robot.body_inertia[body] + spread),
    )
