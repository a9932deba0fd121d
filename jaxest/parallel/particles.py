"""The particles of one filter over devices: each proposes and weighs its share, one collective a step unites them.

Every device then holds all particles and chooses from all of them by the same draws, so resampling is exactly that of
one device: no islands, no exchange of some. What is spread is what costs, the proposal and the likelihood (kinematics,
sensors); resampling, mean and covariance are computed by every device for itself.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec

from jaxest.filters.kalman.model import clean
from jaxest.filters.particle import Guided, Info, Model, State
from jaxest.filters.particle.filter import concluded, settled
from jaxest.filters.particle.guided import picked
from jaxest.parallel.devices import AXIS, mesh
from jaxest.types import Array, PyTree, Step

BLOCKS = 8


def filter_step(model: Model, over: Mesh | None = None, *, blocks: int = BLOCKS) -> Step:
    """Return the particle filter of a model, whose particles are spread over devices.

    Args:
        model: as `jaxest.filters.particle.filter_step` takes it.
        over: the devices, as `mesh` lines them up; all of all processes if None.
        blocks: number of equal blocks of particles, each with random numbers of its own, so that the numbers do not
            depend on how many devices there are; a multiple of that. With 1 they are those of
            `jaxest.filters.particle.filter_step`.

    Returns:
        The step, with the same state and info, which every device holds whole. The same arguments give the same object.

    Raises:
        ValueError: the devices do not divide the blocks, or the proposal is `guided`, which looks at all particles
            before it chooses and wants few: spread many such filters with `shards`. When traced, if the blocks do not
            divide the particles.
    """
    if isinstance(model.propose, Guided):
        raise ValueError("model: a guided proposal wants few particles; spread whole filters, with `shards`")
    line = mesh() if over is None else over
    if blocks < 1 or blocks % line.size:
        raise ValueError(f"blocks: got {blocks}, expected a multiple of the {line.size} device(s)")
    return _filter_step(model, line, blocks)


@cache
def _filter_step(model: Model, line: Mesh, blocks: int) -> Step:
    return partial(_step, model, line, blocks)


def _step(
    model: Model, line: Mesh, blocks: int, params: PyTree, state: State, measurement: PyTree, *,
    key: Array | None = None,
) -> tuple[State, Info]:  # fmt: skip
    if key is None:
        raise ValueError("key: got None, expected the key of the run; a particle filter draws random numbers")
    count = state.log_weights.shape[0]
    if count % blocks:
        raise ValueError(f"particles: got {count}, expected a multiple of the {blocks} blocks")
    # All devices hold the same results, which the check of replication cannot know of resampling's loops.
    share = partial(_share, model, blocks // line.size, blocks)
    whole = PartitionSpec()
    spread = jax.shard_map(share, mesh=line, in_specs=whole, out_specs=whole, check_vma=False)
    return spread(params, state, measurement, key)


def _share(
    model: Model, own: int, blocks: int, params: PyTree, state: State, measurement: PyTree, key: Array
) -> tuple[State, Info]:  # fmt: skip
    """One device's part of a step."""
    measurement, broken = clean(measurement)
    choice, motion = jax.random.split(jax.random.fold_in(key, state.index))
    held, size = jax.lax.stop_gradient(state.particles), state.log_weights.shape[0] // blocks
    first = jax.lax.axis_index(AXIS) * own
    mine = partial(jax.lax.dynamic_slice_in_dim, start_index=first * size, slice_size=own * size)
    chosen = model.resample(choice, state.log_weights)
    before = jax.tree.map(partial(picked, mine(chosen.ancestors)), held)
    keys = motion[None] if blocks == 1 else jax.vmap(partial(jax.random.fold_in, motion))(first + jnp.arange(own))
    moved, increments = _by_block(partial(model.propose, params), before, measurement, keys)
    particles, increments = together(settled(before, moved, increments.astype(state.log_weights.dtype)))
    return concluded(model, state, chosen, particles, increments, broken)


def _by_block(send: Callable[..., Any], particles: PyTree, measurement: PyTree, keys: Array) -> Any:
    """Send each of the blocks with its own key; leaves (blocks * n, ...)."""
    own = keys.shape[0]
    if own == 1:
        return send(particles, measurement, keys[0])
    cut = jax.tree.map(lambda x: x.reshape(own, -1, *x.shape[1:]), particles)
    found = jax.vmap(send, (0, None, 0))(cut, measurement, keys)
    return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), found)


def together(tree: PyTree) -> PyTree:
    """Bring the shares of all devices together, within `shard_map`: one collective for all leaves of one dtype.

    Args:
        tree: leaves (n, ...), this device's.

    Returns:
        The tree with leaves (devices * n, ...), the same on every device.
    """
    leaves, structure = jax.tree.flatten(tree)
    found: list[Any] = list(leaves)
    for dtype in dict.fromkeys(leaf.dtype for leaf in leaves):
        where = [i for i, leaf in enumerate(leaves) if leaf.dtype == dtype]
        flat = [leaves[i].reshape(leaves[i].shape[0], -1) for i in where]
        ends, whole = 0, jax.lax.all_gather(jnp.concatenate(flat, axis=1), AXIS, tiled=True)
        for i, part in zip(where, flat, strict=True):
            columns = whole[:, ends : (ends := ends + part.shape[1])]
            found[i] = columns.reshape(-1, *leaves[i].shape[1:])
    return jax.tree.unflatten(structure, found)


__all__ = ["BLOCKS", "filter_step", "together"]
