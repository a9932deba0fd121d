"""One run of a sampler on one data set, kept for the parts that show it."""

import time
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import jax

from jaxest import kinematics, models
from jaxest.io.chains import sample
from jaxest.mcmc.kernel import Params
from jaxest.reproduce import Choice, Say
from jaxest.systems import torque_model, torque_posterior, torque_sampler, torque_settings
from jaxest.systems.torque_posterior import Posterior
from jaxest.systems.torque_settings import Scene

DEFAULT = "paper"
CHAINS, ITERATIONS = 4, 2500
"""The paper's 10000 iterations, in four chains."""
PAPER_TAU = {
    "gibbs": (0.70007317130, 0.60503887197, 1.79937309232, 0.99945268679, 0.59990970609, 0.24996085840, 0.08499487445),
    "mh": (0.75159, 0.67357, 1.7296, 1.2012, 0.70002, 0.28009),
}
"""N m; table 1, and the means of fig. 2 (the seventh is lost)."""
PAPER_VARIANCES = (
    *(2.7761e-7, 2.8072e-7, 2.9171e-7, 2.9808e-7, 2.7667e-7, 2.9012e-7, 2.8435e-7),
    *(2.6164e-7, 1.9921e-7, 2.6292e-7, 2.2099e-7, 2.1428e-7, 3.5965e-7, 2.8616e-7),
    *(2.4346e-7, 6.6409e-7, 2.6719e-7, 5.197e-7, 5.7298e-7, 6.0577e-7, 1.1084e-7),
)
"""Table 1: S1, S2, S3."""


class Result(NamedTuple):
    """A run."""

    scene: Scene
    posterior: Posterior
    seconds: float
    """Warm-up and compilation included."""
    iterations: int
    chains: int


@cache
def robot() -> Any:
    """Return Baxter's left arm."""
    return kinematics.load(models.path("baxter_left_arm"))


@cache
def scene(setting: str, seed: int) -> Scene:
    """Draw a data set."""
    with jax.enable_x64(True):
        return torque_settings.scene(robot(), torque_settings.named(setting), key=jax.random.key(seed))


@cache
def tuned(setting: str, seed: int, small: bool) -> Params:
    """Warm up for a data set; the same for every sampler."""
    one = scene(setting, seed)
    with jax.enable_x64(True):
        model, key = torque_model.constant(7), jax.random.key(seed + 1000)
        return torque_sampler.tune(model, robot(), one.prior, one.data, key=key, iterations=30 if small else 200)


@cache
def run(
    sampler: str, setting: str, seed: int, *, small: bool = False, count: int | None = None, say: Say | None = None,
    work: Path | None = None, iterations: int = ITERATIONS, chains: int = CHAINS, spread: float = 1.5,
) -> Result:  # fmt: skip
    """Run a sampler from dispersed starts.

    Args:
        sampler: of `torque_sampler.SAMPLERS`.
        setting: of `torque_settings.SETTINGS`.
        seed: of data and chains.
        small: a few iterations.
        count: number of particles, or the sampler's own.
        say: told how far it is.
        work: folder that keeps pieces of the run.
        iterations: of each chain.
        chains: how many.
        spread: of the starts.

    Returns:
        The run.
    """
    begun = time.perf_counter()
    iterations = 24 if small else iterations
    piece = min(250, iterations)
    with jax.enable_x64(True):
        model = torque_model.constant(7)
        shapes = torque_settings.blank(torque_settings.named(setting))
        program = torque_sampler.prepare(
            sampler, model, robot(), *shapes, count=chains, iterations=piece, particles=count
        )  # it compiles while the data are drawn and the sampler is tuned
        one, params = scene(setting, seed), tuned(setting, seed, small)
        start = torque_sampler.start(
            model, params, one.data, key=jax.random.key(seed + 2000), count=chains, spread=spread
        )
        kernel = torque_sampler.sampler(sampler, model, count)
        folder = None if work is None else work / f"{sampler}_{setting}_{seed}_{count}_{iterations}x{chains}_{spread:g}"
        program.result()
        _, history = sample(
            torque_posterior.advance(kernel, params, one.data, spread=sampler in torque_sampler.SPREAD),
            start, iterations, piece=piece, folder=folder, identity=(params, one.data),
            say=None if say is None else _prefixed(say, sampler),
        )  # fmt: skip
        posterior = torque_posterior.collect(model, history, has_path=sampler != "collapsed")
    return Result(one, posterior, time.perf_counter() - begun, iterations, chains)


def _prefixed(say: Say, sampler: str) -> Say:
    return lambda message: say(f"{sampler}: {message}")


def chosen(sampler: str, choice: Choice, say: Say, **more: Any) -> Result:
    """Run a sampler as a person has chosen."""
    setting = choice.setting or DEFAULT
    torque_settings.named(setting)
    return run(sampler, setting, choice.seed, small=choice.small, say=say, work=choice.work, **more)


__all__ = ["CHAINS", "DEFAULT", "ITERATIONS", "PAPER_TAU", "PAPER_VARIANCES", "Result", "chosen", "robot", "run",
           "scene", "tuned"]  # fmt: skip
