"""The posterior of an arm's torques and noise: the paper's run by guided particle Gibbs, beside other samplers.

Effective draws are those of four chains from dispersed starts, bulk, the least of the parameters; the first quarter is
discarded, and compilation and warm-up are not in their seconds. A chain that stands still has about one effective draw
however long it runs: a short run of a frozen sampler flatters it, what it draws in a second falls as it goes on.
"""

import time
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxest import kinematics, models
from jaxest.bench import rollouts, torque_peers
from jaxest.bench.harness import Candidate, Progress, compare, find_peer, race
from jaxest.bench.robots import Subject
from jaxest.bench.torque_peers import Draws
from jaxest.io.report import Row
from jaxest.kinematics.load import compile_model
from jaxest.mcmc import chains as many
from jaxest.mcmc.diagnostics import effective
from jaxest.systems import torque_model, torque_posterior, torque_sampler, torque_settings

CHAINS, ITERATIONS = 4, 2500
"""The paper's 10000 iterations, in four chains."""
SECONDS, PIECE = 30.0, 150
"""How long each peer runs if nothing is said, and how many iterations of NUTS in a row."""
OURS = "guided particle Gibbs, N = 16"


class Case(NamedTuple):
    """What is sampled."""

    robot: Any
    model: Any
    scene: torque_settings.Scene
    params: Any
    starts: Any
    """`Chains`"""


def rows(*, peers: bool, progress: Progress, small: bool = False, seconds: float = SECONDS) -> Iterable[Row]:
    """Run Zakeri 2023's problem in the paper-like setting, in float64 on all devices, and time what is in it.

    Args:
        peers: whether to run the paper's sampler (N = 1000, in NumPy with MuJoCo's dynamics on two cores), the Gibbs
            sampler of `particles` on the same dynamics, NUTS of `blackjax` on the likelihood of the linear model, and
            `mujoco.rollout`.
        progress: hears what is being measured.
        small: a few iterations.
        seconds: how long each of the other samplers runs.

    Yields:
        Seconds of the paper's run, compilation and warm-up included; effective draws a second of torques, of variances
        and of the path at its slowest time; the time of an iteration of our bootstrap particle Gibbs sampler.
    """
    with jax.enable_x64(True):
        progress("data, linearisation and warm-up")
        begun = time.perf_counter()
        iterations = 16 if small else ITERATIONS
        case = problem(small, iterations // 4)
        progress(f"{CHAINS} chains of {iterations} iterations")
        ours, r_hat = _ours(case, iterations)
        whole = time.perf_counter() - begun
        condition = f"{CHAINS} chains of {iterations}, {OURS}, {jax.device_count()} devices"
        yield Row("the paper's run", f"{condition}, compilation and warm-up included", whole, "s")
        yield Row("R-hat, largest", condition, r_hat, "1")
        found = _peers(case, progress, 0.0 if small else seconds, small) if peers else {}
        for name, at in (("torques", 0), ("variances", 1), ("the path", 2)):
            what = f"{name}, {OURS}"
            yield from _beside(f"effective draws of {name}", what, ours, at, found)
        progress("iterations of the bootstrap sampler")
        yield _bootstrap(case, peers, small)


def problem(small: bool, piece: int | None = None) -> Case:
    """Return the paper-like problem, tuned, with chains from dispersed starts; a short warm-up if small.

    Our sampler is compiled meanwhile for that many iterations of a piece.
    """
    robot, model = kinematics.load(models.path("baxter_left_arm")), torque_model.constant(7)
    key = jax.random.key(0)
    setting, program = torque_settings.named("paper"), None
    if piece is not None:
        shapes = torque_settings.blank(setting)
        program = torque_sampler.prepare("gibbs", model, robot, *shapes, count=CHAINS, iterations=piece)
    scene = torque_settings.scene(robot, setting, key=key)
    params = torque_sampler.tune(model, robot, scene.prior, scene.data, key=key, iterations=12 if small else 200)
    starts = torque_sampler.start(model, params, scene.data, key=jax.random.key(1), count=CHAINS)
    if program is not None:
        program.result()
    return Case(robot, model, scene, params, starts)


def _ours(case: Case, iterations: int) -> tuple[Draws, float]:
    """Draws, timed in all pieces but the first, which compiles; and the largest R-hat."""
    piece = iterations // 4
    go = torque_posterior.advance(torque_sampler.sampler("gibbs", case.model), case.params, case.scene.data)
    chains, kept, seconds = case.starts, [], []
    for _ in range(4):
        begun = time.perf_counter()
        chains, history = jax.block_until_ready(go(chains, piece))
        seconds.append(time.perf_counter() - begun)
        kept.append(jax.tree.map(np.asarray, history))
    history = jax.tree.map(lambda *x: np.concatenate(x), *kept)
    found = torque_posterior.collect(case.model, history)
    r_hat = max(one.r_hat for one in found.summaries.values())
    # The first piece is the discarded quarter.
    probe = np.swapaxes(history.probe[piece:], 0, 1)
    return Draws(found.theta, found.variances, probe, sum(seconds[1:])), r_hat


def rate(found: Draws, at: int, discard: float) -> float:
    """Return the least effective draws a second of torques (`at` 0), variances (1) or path (2), a share discarded."""
    x = (found.theta, found.variances, found.path)[at]
    kept = x[:, int(discard * x.shape[1]) :]
    return min(effective(kept[:, :, i]) for i in range(kept.shape[2])) / (found.seconds * (1 - discard))


def _peers(case: Case, progress: Progress, seconds: float, small: bool) -> dict[str, Draws | str]:
    """What other samplers draw from the same starts, or the package that is not installed."""
    model = compile_model(models.path("baxter_left_arm"))
    problem = torque_peers.problem(model, case.scene.data, case.scene.prior)
    starts = jax.tree.map(np.asarray, case.starts.chain)
    count = 20 if small else 1000
    progress("the paper's sampler in NumPy")
    found: dict[str, Draws | str] = {
        f"the paper's sampler, N = {count}, in NumPy": torque_peers.paper(problem, starts, seconds, count)
    }
    mcmc = find_peer("particles.mcmc")
    progress("particles' Gibbs sampler")
    found[f"particles' Gibbs sampler, N = {count}"] = (
        torque_peers.particles_gibbs(mcmc, problem, starts, seconds, count) if mcmc else "particles"
    )
    blackjax = find_peer("blackjax")
    progress("blackjax' NUTS")
    found["blackjax' NUTS on the linear model's likelihood"] = (
        torque_peers.nuts(
            blackjax, case.model, case.params, case.scene.data, case.starts.chain, 8 if small else PIECE, seconds
        )
        if blackjax
        else "blackjax"
    )
    return found


def _beside(metric: str, condition: str, ours: Draws, at: int, peers: dict[str, Draws | str]) -> Iterable[Row]:
    value = rate(ours, at, 0.0)
    if not peers:
        yield Row(metric, condition, value, "1/s")
    for name, found in peers.items():
        if at == 2 and not isinstance(found, str) and not found.path.shape[-1]:
            continue
        row = Row(metric, condition, value, "1/s", n=ours.theta.shape[0] * ours.theta.shape[1])
        if isinstance(found, str):
            yield row._replace(reference_name=f"{found} is not installed: pip install --no-deps {found}")
            continue
        theirs = rate(found, at, 0.25)
        length = f"{name}, {found.theta.shape[0]} x {found.theta.shape[1]} iterations"
        yield row._replace(reference=theirs, reference_name=length, ratio=value / theirs)


def _bootstrap(case: Case, peers: bool, small: bool) -> Row:
    """Time an iteration of the paper's sampler as we have it: one chain, whose particles XLA spreads over the cores."""
    count, iterations = 20 if small else 1000, 2
    kernel = torque_sampler.sampler("gibbs_bootstrap", case.model, count)
    alone = jax.tree.map(lambda x: x[:1], case.starts.chain)
    start = many.Chains(alone, case.starts.key[:1], case.starts.index)

    def iterate() -> Any:
        return many.advance(kernel, case.params, case.scene.data, start, iterations)

    jax.block_until_ready(iterate())
    candidates = [Candidate("ours", iterate, iterations)]
    steps = case.scene.data.value.shape[0]
    name = f"mujoco.rollout, {count} x {steps} steps on {rollouts.THREADS} threads"
    if peers:
        candidates.append(Candidate(name, rollouts.mujoco_rollout(_subject(case, count), steps)))
    timed = race(candidates, repeats=2 if small else 5, min_time=0.0)
    condition = f"particle Gibbs, bootstrap, N = {count}, T = {steps}, one chain, float64"
    return compare("iteration", condition, timed["ours"], timed.get(name), unit="ms")


def _subject(case: Case, count: int) -> Subject:
    """The arm at rest where the series starts, with the paper's torques."""
    source = models.path("baxter_left_arm")
    model = compile_model(source)
    model.opt.timestep = float(case.scene.data.inputs.dt[0])
    q = np.broadcast_to(torque_settings.FALLING, (count, 7))
    tau = np.broadcast_to(torque_settings.TORQUE, (count, 7))
    return Subject("baxter_left_arm", source, case.robot, model, None, q, 0 * q, tau)


__all__ = ["CHAINS", "ITERATIONS", "SECONDS", "rate", "rows"]
