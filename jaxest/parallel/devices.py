"""A batch axis of independent items over devices."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from jaxest.types import PyTree

AXIS = "batch"


def mesh(devices: Sequence[jax.Device] | None = None) -> Mesh:
    """Line devices up along the batch axis.

    Args:
        devices: which; all devices of all processes if None.

    Returns:
        A mesh with the one axis `batch`.
    """
    return Mesh(np.asarray(jax.devices() if devices is None else list(devices)), (AXIS,))


def several() -> Mesh | None:
    """Return all devices as `mesh` lines them up, or None where there is but one and nothing to spread."""
    return mesh() if jax.device_count() > 1 else None


@dataclass(frozen=True, eq=False)
class Spread:
    """A function spread over a batch, as `shards` makes it."""

    fn: Callable[..., PyTree]
    line: Mesh
    common: int
    apart: bool
    step: Any
    """The jitted program."""

    def __call__(self, *args: PyTree) -> PyTree:
        """Run it on whole batches; see `shards`."""
        same, batch = args[: self.common], args[self.common :]
        items = _items(batch)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(batch)):
            # Traced, for shapes or within another program: not laid on devices.
            return _share(self.fn, self.apart, same, batch)
        whole, part = (NamedSharding(self.line, spec) for spec in (PartitionSpec(), PartitionSpec(AXIS)))
        rows = np.minimum(np.arange(-(-items // self.line.size) * self.line.size), items - 1)
        batch = jax.tree.map(lambda leaf: _place(leaf, rows, part), batch)
        same = jax.tree.map(lambda leaf: _place(leaf, ..., whole), same)
        found = self.step(same, batch)
        return found if len(rows) == items else jax.tree.map(lambda leaf: leaf[:items], found)

    def prepare(self, *args: PyTree) -> None:
        """Compile for arguments of these shapes, so that a later call finds its program; from a thread, if wished.

        Args:
            args: as in a call; only shapes and dtypes are looked at, `jax.ShapeDtypeStruct` will do.
        """
        same, batch = args[: self.common], args[self.common :]
        items = -(-_items(batch) // self.line.size) * self.line.size
        whole, part = (NamedSharding(self.line, spec) for spec in (PartitionSpec(), PartitionSpec(AXIS)))
        shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype, sharding=whole), same)
        many = jax.tree.map(lambda x: jax.ShapeDtypeStruct((items, *x.shape[1:]), x.dtype, sharding=part), batch)
        self.step.lower(shapes, many).compile()


def shards(
    fn: Callable[..., PyTree], over: Mesh | None = None, *, common: int = 0, apart: bool = False
) -> Spread:  # fmt: skip
    """Spread a function over a batch, a share of it on each device.

    Args:
        fn: takes one item (pytrees of arrays) and returns a pytree; pure.
        over: the devices, as `mesh` lines them up; all of them if None.
        common: how many of the first arguments are the same for all items and have no batch axis.
        apart: whether a device takes its items one after the other instead of side by side.

    Returns:
        A jitted function of the same arguments, each leaf with a leading axis of n items; its results have that axis
        too and live spread over the devices (`gather` brings them to every host). A batch that the number of devices
        does not divide is filled up with copies of its last item, which are dropped again. Every process gives the
        whole batch. Call the same one again: each has a program of its own.

    Raises:
        ValueError: when called, if the leaves' leading axes differ.
    """
    line = mesh() if over is None else over
    whole, part = PartitionSpec(), PartitionSpec(AXIS)
    share = partial(_share, fn, apart)
    # Shares are independent, and an estimator's scan starts from constants: nothing for the check to find.
    step = jax.jit(jax.shard_map(share, mesh=line, in_specs=(whole, part), out_specs=part, check_vma=False))
    return Spread(fn, line, common, apart, step)


def _share(fn: Callable[..., PyTree], apart: bool, same: tuple[PyTree, ...], items: tuple[PyTree, ...]) -> PyTree:
    every = one_by_one if apart else jax.vmap
    return every(lambda *item: fn(*same, *item))(*items)


def one_by_one(fn: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """Return a function of batches that runs `fn`, of one item, on one after the other.

    What an item skips by `lax.cond` is skipped; under `vmap` a batch does it for all. It pays where that is most of the
    work, as in a filter that corrects at every tenth sample.

    Args:
        fn: takes one item (pytrees of arrays) and returns a pytree; pure.

    Returns:
        A function of the same arguments, each leaf with a leading axis; its results have that axis too.
    """
    return lambda *items: jax.lax.map(lambda item: fn(*item), items)


def _items(batch: PyTree) -> int:
    """Return the number of items of a batch; raise ValueError where its leaves disagree."""
    sizes = [np.shape(leaf)[:1] for leaf in jax.tree.leaves(batch)]
    if len(set(sizes)) != 1 or () in sizes:
        raise ValueError(f"batch: leading axes {sorted(set(sizes))}, expected one number of items on every leaf")
    return int(sizes[0][0])


def everywhere(tree: PyTree, over: Mesh | None = None) -> PyTree:
    """Put the same arrays on all devices, once, where calls of a function made by `shards` share them.

    Args:
        tree: whole on every host.
        over: the devices, as `mesh` lines them up; all of them if None.

    Returns:
        The tree, for `shards(..., common=...)`.
    """
    line = mesh() if over is None else over
    return jax.tree.map(lambda leaf: _place(leaf, ..., NamedSharding(line, PartitionSpec())), tree)


def _place(leaf: Any, rows: Any, spread: NamedSharding) -> jax.Array:
    """Put each device's share of a leaf's rows on it; the leaf is whole on every host."""
    if rows is ... and isinstance(leaf, jax.Array) and leaf.sharding == spread:
        return leaf  # it is there already
    if jnp.issubdtype(getattr(leaf, "dtype", np.float32), jax.dtypes.prng_key):
        words = _place(jax.random.key_data(leaf), rows, spread)
        return jax.random.wrap_key_data(words, impl=jax.random.key_impl(leaf))
    whole = np.asarray(leaf)[rows]
    return jax.make_array_from_callback(whole.shape, spread, lambda index: whole[index])


def gather(tree: PyTree) -> PyTree:
    """Bring results to the host of every process.

    Args:
        tree: what a function made by `shards` returned.

    Returns:
        The same tree with NumPy arrays, whole on each process.
    """
    if jax.process_count() == 1:
        return jax.tree.map(np.asarray, tree)
    from jax.experimental.multihost_utils import process_allgather

    return jax.tree.map(np.asarray, process_allgather(tree, tiled=True))


__all__ = ["Spread", "everywhere", "gather", "mesh", "one_by_one", "several", "shards"]
