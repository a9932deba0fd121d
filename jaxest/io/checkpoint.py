"""Checkpoints: the state pytree of any estimator, bit for bit, in an NPZ file that is validated on load.

The file holds one array a leaf (`leaf0`, `leaf1`, ...) and the JSON text `checkpoint`: format version, and path, kind,
dtype and shape of each leaf. Structure and types of containers come from the `like` that `load_state` is given, so that
nothing in the file is ever executed.
"""

import json
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.files import PathLike
from jaxest.io import npz
from jaxest.io.raw import Raw
from jaxest.types import InputError, PyTree, unknown_name

FORMAT, VERSION = "jaxest-checkpoint", 1
_SCALARS: dict[str, type] = {"bool": bool, "int": int, "float": float, "complex": complex}


class Leaf(NamedTuple):
    """What the file says about one leaf."""

    path: str
    kind: str
    """`array`, `key` for typed random keys, or the Python type of a scalar."""
    dtype: str
    shape: tuple[int, ...]
    implementation: str = ""
    """Of a random key, such as `threefry2x32`."""


def save_state(path: PathLike, state: PyTree, overwrite: bool = False) -> None:
    """Write a state, whole or not at all.

    Args:
        path: where it goes, usually `.npz`.
        state: any pytree of arrays, typed random keys and Python numbers (NamedTuples, dicts, registered
            dataclasses, None).
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the output exists or cannot be written, or a leaf is neither array nor number.
    """
    leaves, arrays = [], {}
    for i, (name, value) in enumerate(_flatten(state)):
        leaf, stored = _describe(name, value, str(path))
        leaves.append(leaf)
        arrays[f"leaf{i}"] = stored
    header = {"format": FORMAT, "version": VERSION, "leaves": [leaf._asdict() for leaf in leaves]}
    npz.save(path, {"checkpoint": np.array(json.dumps(header)), **arrays}, overwrite)


def load_state(path: PathLike, like: PyTree) -> PyTree:
    """Read a state.

    Args:
        path: what `save_state` wrote.
        like: a state of the same structure, shapes and dtypes, for example `init(params)`; leaves may be
            `jax.ShapeDtypeStruct`.

    Returns:
        The state: JAX arrays where `like` has those, NumPy arrays and Python numbers where it has these.

    Raises:
        InputError: not a checkpoint, a leaf that is missing or too many, or a wrong shape or dtype; names the leaf.
    """
    import jax

    raw = npz.load(path)
    stored = _header(raw)
    flat = _flatten(like)
    wanted = [name for name, _ in flat]
    for name in wanted:
        if name not in stored:
            raise InputError(f"{path}: {unknown_name('leaf', name, stored)}; expected it in the state")
    for name in stored:
        if name not in wanted:
            raise InputError(f"{path}: holds a leaf {name!r} that the expected state has not")
    leaves = [_restore(str(path), *stored[name], value) for name, value in flat]
    return jax.tree_util.tree_unflatten(jax.tree_util.tree_structure(like), leaves)


def _flatten(state: PyTree) -> list[tuple[str, Any]]:
    import jax

    return [(jax.tree_util.keystr(p) or "state", leaf) for p, leaf in jax.tree_util.tree_flatten_with_path(state)[0]]


def _is_key(value: Any) -> bool:
    import jax

    return hasattr(value, "dtype") and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key)


def _describe(name: str, value: Any, path: str) -> tuple[Leaf, NDArray[Any]]:
    """Return a leaf's entry and the array that is stored for it."""
    import jax

    if _is_key(value):
        leaf = Leaf(name, "key", str(value.dtype), tuple(value.shape), str(jax.random.key_impl(value)))
        return leaf, np.asarray(jax.random.key_data(value))
    kind = type(value).__name__
    if isinstance(value, bool | int | float | complex) and kind in _SCALARS:
        array = np.asarray(value)
        if array.dtype.hasobject:
            raise InputError(f"{path}: leaf {name!r} is an integer too large for 64 bits")
        return Leaf(name, kind, str(array.dtype), ()), array
    if not isinstance(value, jax.Array | np.ndarray | np.generic) or np.asarray(value).dtype.kind in "OSUM":
        raise InputError(f"{path}: leaf {name!r} is a {kind}, expected an array or a number")
    array = np.asarray(value)
    return Leaf(name, "array", str(array.dtype), array.shape), _storable(array)


def _storable(array: NDArray[Any]) -> NDArray[Any]:
    """View dtypes that NPZ does not know (bfloat16 and its like) as bytes."""
    if array.dtype.kind in "biufc":
        return array
    return np.ascontiguousarray(array).reshape(array.shape).view(f"u{array.dtype.itemsize}")


def _header(raw: Raw) -> dict[str, tuple[Leaf, NDArray[Any]]]:
    """Return the leaves of a checkpoint by path."""
    place = f"{raw.source}: not a checkpoint"
    text = raw.arrays.get("checkpoint")
    if text is None or text.dtype.kind != "U" or text.shape != ():
        raise InputError(f"{place}: it has no text 'checkpoint'; holds {', '.join(raw.arrays) or 'nothing'}")
    try:
        header = json.loads(text.item())
        if header["format"] != FORMAT:
            raise ValueError(f"format {header['format']!r}")
        if header["version"] != VERSION:
            raise InputError(f"{raw.source}: checkpoint of version {header['version']}, expected {VERSION}")
        leaves = [
            Leaf(e["path"], e["kind"], e["dtype"], tuple(map(int, e["shape"])), e["implementation"])
            for e in header["leaves"]
        ]
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{place}: its header is damaged ({error!r})") from error
    found = {}
    for i, leaf in enumerate(leaves):
        if f"leaf{i}" not in raw.arrays:
            raise InputError(f"{raw.source}: the array of leaf {leaf.path!r} is missing")
        found[leaf.path] = (leaf, raw.arrays[f"leaf{i}"])
    return found


def _restore(path: str, leaf: Leaf, stored: NDArray[Any], like: Any) -> Any:
    """Return a leaf as `like` has it, or say how the file's differs."""
    import jax

    place = f"{path}: leaf {leaf.path!r}"
    kind, shape, dtype = _expected(like)
    if leaf.kind != kind:
        raise InputError(f"{place} is {leaf.kind!r}, expected {kind!r}")
    if leaf.shape != shape or leaf.dtype != dtype:
        raise InputError(f"{place} is {leaf.dtype} {leaf.shape}, expected {dtype} {shape}")
    if kind in _SCALARS:
        return _SCALARS[kind](_fitting(place, stored, np.dtype(dtype), shape).item())
    if kind == "key":
        return _key(place, leaf, stored)
    array = _fitting(place, stored, np.dtype(like.dtype), shape)
    if not isinstance(like, jax.Array | jax.ShapeDtypeStruct):
        return array
    restored = jax.numpy.asarray(array)
    if restored.dtype != array.dtype:
        raise InputError(f"{place} is {array.dtype}, which JAX holds only with jax_enable_x64 on")
    return restored


def _key(place: str, leaf: Leaf, stored: NDArray[Any]) -> Any:
    import jax

    try:
        key = jax.random.wrap_key_data(jax.numpy.asarray(stored), impl=leaf.implementation)
    except (TypeError, ValueError) as error:
        raise InputError(f"{place}: not a random key of {leaf.implementation!r} ({error})") from error
    if key.shape != leaf.shape or str(key.dtype) != leaf.dtype:
        raise InputError(f"{place}: holds {key.dtype} {key.shape}, its header says {leaf.dtype} {leaf.shape}")
    return key


def _expected(like: Any) -> tuple[str, tuple[int, ...], str]:
    if _is_key(like):
        return "key", tuple(like.shape), str(like.dtype)
    if type(like).__name__ in _SCALARS and not hasattr(like, "dtype"):
        return type(like).__name__, (), str(np.asarray(like).dtype)
    return "array", tuple(like.shape), str(like.dtype)


def _fitting(place: str, stored: NDArray[Any], dtype: np.dtype[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the stored array in its dtype, after making sure that it is what the header says."""
    if dtype.kind not in "biufc" and stored.dtype == np.dtype(f"u{dtype.itemsize}"):
        stored = stored.view(dtype)
    if stored.dtype != dtype or stored.shape != shape:
        raise InputError(f"{place}: the array is {stored.dtype} {stored.shape}, its header says {dtype} {shape}")
    return stored
