"""How far the moments of samples are from the exact ones, over whole tables of settings, in float32.

    python benchmarks/samples.py ORACLES [--draws 200000] [--seed 0] [--json]

ORACLES is a folder with `bingham_s3.npz` (`lam`) and `von_mises.npz` (`kappa`): only their settings are taken, the
moments are the library's own in float64, which tests hold against the tables. Printed are the largest deviation in
standard errors, that expected by chance of as many (the median of the largest), and how many lie beyond 4.
"""

import argparse
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy import special, stats

from jaxest.distributions import bingham, von_mises
from jaxest.io.report import Row, report, to_json


def bingham_deviations(lam: NDArray[np.float32], draws: int, seed: int) -> NDArray[np.float64]:
    """Deviations of the ten second moments and the four means, for each of the settings (n, 4)."""
    sample = jax.jit(lambda key, lam: bingham.sample(key, bingham.standard(lam), (draws,)))
    found = []
    for i, one in enumerate(lam):
        x = np.asarray(sample(jax.random.fold_in(jax.random.key(seed), i), jnp.asarray(one)), np.float64)
        with jax.enable_x64(True):
            exact = np.asarray(one, np.float64)
            second, fourth = np.asarray(bingham.second_moments(exact)), np.asarray(bingham.fourth_moments(exact))
        upper = np.triu_indices(4)
        away = (x.T @ x / draws - np.diag(second))[upper]
        error = np.sqrt((fourth - np.diag(second**2))[upper] / draws)
        found.append(np.concatenate([away / error, x.mean(axis=0) / np.sqrt(second / draws)]))
    return np.concatenate(found)


def von_mises_deviations(table: NDArray[np.float32], draws: int, seed: int, fast: bool) -> NDArray[np.float64]:
    """Deviations of E[1 - cos], E[sin] and E[sin^2] for each of the concentrations (n,)."""
    general = jax.jit(lambda key, k: von_mises.sample(key, 0.0, k, (draws,)))
    table_of = jax.jit(lambda key, sampler: von_mises.sample_fast(key, sampler, shape=(draws,)))
    found = []
    for i, k in enumerate(table):
        key = jax.random.fold_in(jax.random.key(seed), i)
        x = np.asarray(table_of(key, von_mises.fast_sampler(float(k))) if fast else general(key, k), np.float64)
        with jax.enable_x64(True):
            short = 1 - von_mises.mean_resultant_length(np.float64(k)) if k < 1e3 else np.nan
        half, sine = 2 * np.sin(x / 2) ** 2, np.sin(x)
        square = float(special.ive(1, k) / special.ive(0, k) / k) if k else 0.5
        complement = float(short) if np.isfinite(short) else 1 / (2 * k) + 1 / (8 * float(k) ** 2)
        parts = ((half, complement), (sine, 0.0), (sine**2, square))
        found += [(np.mean(v) - mean) / (np.std(v) / np.sqrt(draws)) for v, mean in parts]
    return np.array(found)


def rows(name: str, z: NDArray[np.float64], settings: int) -> list[Row]:
    """What is printed of a family's deviations."""
    chance = float(stats.norm.isf((1 - 0.5 ** (1 / z.size)) / 2))
    beyond = 2 * float(stats.norm.sf(4)) * z.size
    return [
        Row(f"{name}: largest of {z.size} moments", f"{settings} settings", float(np.abs(z).max()), "standard errors",
            reference=chance, reference_name="by chance, median"),
        Row(f"{name}: beyond 4 standard errors", f"{settings} settings", float(np.sum(np.abs(z) > 4)), "1",
            reference=beyond, reference_name="by chance, mean"),
        Row(f"{name}: root mean square", f"{settings} settings", float(np.sqrt(np.mean(z**2))), "standard errors",
            reference=1.0, reference_name="by chance"),
    ]  # fmt: skip


def main() -> None:
    """Draw and print."""
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("oracles", type=Path)
    words.add_argument("--draws", type=int, default=200_000)
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--json", action="store_true")
    given = words.parse_args()
    lam = np.load(given.oracles / "bingham_s3.npz")["lam"].astype(np.float32)
    kappa = np.load(given.oracles / "von_mises.npz")["kappa"].astype(np.float32)
    found: list[Row] = []
    print("Bingham ...", file=sys.stderr, flush=True)
    found += rows("Bingham", bingham_deviations(lam, given.draws, given.seed), len(lam))
    for fast, name in ((False, "von Mises"), (True, "von Mises, fast map")):
        print(f"{name} ...", file=sys.stderr, flush=True)
        found += rows(name, von_mises_deviations(kappa, given.draws, given.seed, fast), len(kappa))
    if given.json:
        print(to_json(report("samples", found)))
        return
    for row in found:
        chance = f"{row.reference_name} {row.reference:.3f}"
        print(f"{row.metric:44} {row.condition:14} {row.value:8.3f} {row.unit:16} {chance}")


if __name__ == "__main__":
    main()
