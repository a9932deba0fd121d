"""Exact rejection sampling in fixed shapes: rounds of proposals until every slot has an accepted one.

A round costs one draw of random bits, however many slots there are. The loop ends when all slots are filled or after
the given number of rounds; `done` tells which slots hold an accepted draw. No derivative passes through.
"""

from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp

from jaxest.types import Array


class Draws(NamedTuple):
    """Draws of a rejection sampler."""

    value: Array
    """(*shape, ...) the draws; where not done, a draw from the envelope."""
    done: Array
    """(*shape,) bool, whether a proposal was accepted within the rounds."""


class Propose(Protocol):
    """Draws one proposal per slot."""

    def __call__(self, key: Array) -> tuple[Array, Array]:
        """Return proposals (n, ...) and whether each is accepted (n,) bool."""
        ...


ROUNDS = 64  # at an acceptance of 0.44 a slot is left over with probability 1e-16


def each(key: Array, propose: Propose, rounds: int = ROUNDS) -> Draws:
    """Let every slot wait for its own accepted proposal; slots may differ in their distribution.

    Args:
        key: random key.
        propose: proposals (n, ...) and acceptances (n,).
        rounds: most rounds, static.

    Returns:
        Draws (n, ...) and done (n,). About log(n) rounds are needed.
    """
    first = propose(jax.random.fold_in(key, 0))

    def more(carry: tuple[Array, Array, Array]) -> Array:
        index, _, done = carry
        return (index < rounds) & ~jnp.all(done)

    def body(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        index, value, done = carry
        proposal, accepted = propose(jax.random.fold_in(key, index))
        keep = done.reshape(done.shape + (1,) * (value.ndim - done.ndim))
        return index + 1, jnp.where(keep, value, proposal), done | accepted

    _, value, done = jax.lax.while_loop(more, body, (jnp.asarray(1, jnp.int32), *first))
    return Draws(value, done)


def pooled(key: Array, propose: Propose, rounds: int = ROUNDS) -> Draws:
    """Fill slots of one distribution with whatever is accepted, in the order of drawing.

    Args:
        key: random key.
        propose: independent, identically distributed proposals (n, ...) and acceptances (n,).
        rounds: most rounds, static.

    Returns:
        Draws (n, ...), the first n accepted proposals, and done (n,). About 1 / acceptance rounds are needed.
    """
    first, accepted = propose(jax.random.fold_in(key, 0))
    count = accepted.shape[0]

    def fill(value: Array, filled: Array, proposal: Array, accepted: Array) -> tuple[Array, Array]:
        rank = filled + jnp.cumsum(accepted) - 1
        slot = jnp.where(accepted & (rank < count), rank, count)
        return value.at[slot].set(proposal, mode="drop"), jnp.minimum(filled + jnp.sum(accepted), count)

    def more(carry: tuple[Array, Array, Array]) -> Array:
        index, _, filled = carry
        return (index < rounds) & (filled < count)

    def body(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        index, value, filled = carry
        value, filled = fill(value, filled, *propose(jax.random.fold_in(key, index)))
        return index + 1, value, filled

    value, filled = fill(first, jnp.zeros((), jnp.cumsum(accepted).dtype), first, accepted)
    _, value, filled = jax.lax.while_loop(more, body, (jnp.asarray(1, jnp.int32), value, filled))
    return Draws(value, jnp.arange(count) < filled)
