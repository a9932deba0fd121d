"""Which numbers of a parameter pytree are free, under which constraint; all others are frozen.

`space(params, {"walk": positive, "sensors.imu2.lam+sensors.imu3.lam": bingham})` names leaves by their paths; leaves
joined by `+` are one and the same. A point of the space is a vector (n,), whose `unpack` is the whole pytree.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.tuning.transforms import Bijection, Constraint, named, usual
from jaxest.types import Array, InputError, PyTree, unknown_name


class Free(NamedTuple):
    """One free value."""

    paths: tuple[str, ...]
    """Of the leaves that take it."""
    bijection: Bijection
    shape: tuple[int, ...]

    @property
    def name(self) -> str:
        """The first path, and how many share its value."""
        return self.paths[0] + (f" (+{len(self.paths) - 1})" if len(self.paths) > 1 else "")


@dataclasses.dataclass(frozen=True, eq=False)
class Space:
    """All free values: static, hashed by identity. Build it once."""

    free: tuple[Free, ...]
    base: PyTree
    """The parameters, frozen leaves and starts."""
    paths: tuple[str, ...]
    """Of all leaves, in order."""

    @property
    def size(self) -> int:
        """n, free numbers."""
        return sum(one.bijection.size for one in self.free)

    def pack(self, params: PyTree, dtype: Any = None) -> Array:
        """Return the point (n,) of parameters, in their floating dtype unless said."""
        leaves = dict(zip(self.paths, jax.tree.leaves(params), strict=True))
        dtype = jnp.result_type(float) if dtype is None else dtype
        parts = [one.bijection.unconstrain(jnp.asarray(leaves[one.paths[0]], dtype)) for one in self.free]
        return jnp.concatenate(parts)

    def unpack(self, z: Array) -> PyTree:
        """Return the parameters at a point (n,): all floating leaves in its dtype, frozen ones as they were."""
        found, at = {}, 0
        for one in self.free:
            value = one.bijection.constrain(z[at : at + one.bijection.size])
            at += one.bijection.size
            found.update(dict.fromkeys(one.paths, value))
        leaves, tree = jax.tree.flatten(self.base)
        return jax.tree.unflatten(
            tree, [found.get(path, _typed(leaf, z.dtype)) for path, leaf in zip(self.paths, leaves, strict=True)]
        )

    def values(self, z: Array) -> Array:
        """Return the entries of the free values at a point, constrained, one after the other: (m,)."""
        leaves = dict(zip(self.paths, jax.tree.leaves(self.unpack(z)), strict=True))
        return jnp.concatenate([leaves[one.paths[0]].reshape(-1) for one in self.free])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of `values`, such as `walk` and `sensors.imu2.lam[1]`."""
        return tuple(
            one.paths[0] + ("" if one.shape == () else "[" + ",".join(map(str, index)) + "]")
            for one in self.free
            for index in np.ndindex(one.shape)
        )


def _typed(leaf: Any, dtype: Any) -> Any:
    floating = jnp.issubdtype(jnp.result_type(leaf), jnp.floating)
    return jnp.asarray(leaf, dtype) if floating else leaf


def paths(params: PyTree) -> tuple[str, ...]:
    """Return the path of every leaf, such as `sensors.imu2.lam`."""
    return tuple(
        jax.tree_util.keystr(path, simple=True, separator=".")
        for path, _ in jax.tree_util.tree_flatten_with_path(params)[0]
    )


def space(params: PyTree, free: Mapping[str, Constraint | None] | Iterable[str]) -> Space:
    """Say which leaves are free.

    Args:
        params: the parameters at the start; frozen leaves keep their values.
        free: path -> constraint; None, or a path alone, takes the usual one of its name and value. `a+b` ties leaves
            of one shape, which all start from the value of the first.

    Returns:
        The space.

    Raises:
        InputError: a path does not exist (the closest is named), is free twice, tied leaves differ in shape, a value
            lies outside its constraint, or nothing is free.
    """
    chosen = dict(free) if isinstance(free, Mapping) else dict.fromkeys(free)
    known = paths(params)
    leaves = dict(zip(known, jax.tree.leaves(params), strict=True))
    found: list[Free] = []
    taken: set[str] = set()
    for key, constraint in chosen.items():
        tied = tuple(part.strip() for part in key.split("+"))
        for path in tied:
            if path not in leaves:
                raise unknown_name("parameter", path, known)
            if path in taken:
                raise InputError(f"parameter {path!r} is free twice, expected once")
            taken.add(path)
        found.append(_free(tied, leaves, constraint))
    if not found:
        raise InputError(f"no parameter is free, expected at least one of {', '.join(known)}")
    return Space(tuple(found), params, known)


def _free(tied: tuple[str, ...], leaves: Mapping[str, Any], constraint: Constraint | None) -> Free:
    value = np.asarray(leaves[tied[0]])
    for path in tied[1:]:
        shape = np.shape(leaves[path])
        if shape != value.shape:
            raise InputError(f"parameter {path!r} has shape {shape}, expected {value.shape} as {tied[0]!r} has")
    if not np.issubdtype(value.dtype, np.floating) and not np.issubdtype(value.dtype, np.integer):
        raise InputError(f"parameter {tied[0]!r} is of type {value.dtype}, expected numbers")
    try:
        return Free(tied, (constraint or named(usual(tied[0], value)))(value), value.shape)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"parameter {tied[0]!r}: {error}") from error


__all__ = ["Free", "Space", "paths", "space"]
