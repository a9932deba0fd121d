"""Bingham densities on rotations: normaliser with its moments, and draws, beside `pyrecest`."""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxest.bench.harness import Candidate, Progress, candidate, compare, compile_row, find_peer, race
from jaxest.distributions import bingham
from jaxest.io.report import Row

CASES = ((-800.0, -800.0, -0.5, 0.0), (-50.0, -20.0, -5.0, 0.0), (-3.0, -2.0, -1.0, 0.0), (-300.0, -300.0, -300.0, 0.0))
"""Concentrations: Table I's kind of sensor with its yaw hardly known, two plain ones, and a sharp one."""


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time float32 batches; the peer computes in float64, one density at a time.

    Args:
        peers: whether to run `pyrecest`.
        progress: hears what is being measured.
        small: few densities and draws.

    Yields:
        Times per normaliser with its gradient and per draw, differences of the normalisers, and times to compile.
    """
    progress("bingham")
    count, draws = (8, 16) if small else (4096, 4096)
    lam = jnp.asarray(np.resize(np.array(CASES), (count, 4)), jnp.float32)
    both = jax.jit(jax.vmap(jax.value_and_grad(bingham.log_normalizer)))
    given = bingham.standard(jnp.asarray(CASES[1], jnp.float32))
    sample = jax.jit(lambda key: bingham.sample(key, given, (draws,)))
    candidates = [
        candidate("normaliser", both, lam, items=count),
        candidate("draw", sample, jax.random.key(0), items=draws),
    ]
    peer: Any = find_peer("pyrecest.distributions") if peers else None
    missing = "pyrecest" if peers and peer is None else ""
    if peer is not None:
        candidates += [
            Candidate("pyrecest, normaliser", lambda: [_density(peer, one).F for one in CASES], len(CASES)),
            Candidate("pyrecest, sample", lambda: _density(peer, CASES[1]).sample(draws), draws),
        ]
    found = race(candidates, repeats=2 if small else 10)
    condition = f"{count} densities at once, with the second moments, each"
    yield compare("normaliser", condition, found["normaliser"], found.get("pyrecest, normaliser"), missing=missing)
    beside = found.get("pyrecest, sample")
    yield compare("draw", f"{draws} draws of one density, each", found["draw"], beside, missing=missing)
    if peer is not None:
        ours = np.asarray(both(lam)[0])
        for i, one in enumerate(CASES):
            theirs = float(np.log(_density(peer, one).F))
            words = ", ".join(f"{x:g}" for x in one)
            yield Row("log of the normaliser", f"({words})", float(ours[i]), "1", None, 1, theirs, "pyrecest")
    for name in ("normaliser", "draw"):
        yield compile_row(name, found[name])


def _density(peer: Any, lam: tuple[float, ...]) -> Any:
    return peer.BinghamDistribution(np.array(sorted(lam)), np.eye(4))
