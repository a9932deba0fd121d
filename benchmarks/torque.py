"""How close the samplers of joint torques come to a posterior that is known.

    python benchmarks/torque.py ORACLE.npz [--samplers gibbs mh collapsed] [--draws 1000] [--most 20000] [--seed 0]
        [--robot baxter_left_arm.xml] [--devices 2] [--json]

Each sampler runs four chains from dispersed starts until every parameter has so many effective draws, bulk and tail, or
until the chains have so many iterations each. Rows: the largest distance of the means to the oracle's in its posterior
deviations, the farthest ratio of deviations, for the torques and for the logarithms of the variances of S1 and S3; S2
beside its prior; what the chains say of themselves; and how far estimates of the log-likelihood scatter. An oracle
is an NPZ file of a series and of a long run's posterior, with the arrays that `problem` and `against` below read; the
repository holds none. Accuracy over many data sets is `jaxest reproduce zakeri2023 --part
accuracy`, speed `jaxest bench torque`.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import polygamma, psi

from jaxest import kinematics, models
from jaxest.io.chains import sample
from jaxest.io.report import Row, report, to_json
from jaxest.mcmc import particle_mh
from jaxest.mcmc.model import Data, Prior, Unknown
from jaxest.systems import torque_model, torque_posterior, torque_sampler
from jaxest.systems.torque_model import Inputs

SAMPLERS = ("gibbs", "mh", "collapsed")
PIECE = 500


def say(text: str) -> None:
    """Tell on standard error what is being done."""
    print(text, file=sys.stderr, flush=True)


def problem(oracle: Any) -> tuple[Data, Prior]:
    """Return the series and the priors of an oracle."""
    y, p, count = oracle["y"], len(oracle["tau_true"]), len(oracle["s_true"])
    steps, size = len(y) - 1, len(oracle["m0"])
    given = Inputs(jnp.full(steps, float(oracle["h"])), _fed(oracle, steps, p), jnp.zeros(steps, jnp.int32))
    valid = np.isfinite(y)
    prior = Prior(
        jnp.asarray(oracle["prior_tau_lo"]), jnp.asarray(oracle["prior_tau_hi"]),
        jnp.full(count, float(oracle["prior_IG_shape"])), jnp.full(count, float(oracle["prior_IG_scale"])),
        jnp.asarray(oracle["m0"]), jnp.broadcast_to(jnp.asarray(oracle["p0"]), (size,)),
    )  # fmt: skip
    return Data(jnp.asarray(np.where(valid, y, 0)), jnp.asarray(valid), given), prior


def _fed(oracle: Any, steps: int, joints: int) -> Any:
    """Known torques (T - 1, n): the last rows of `feedforward` where the oracle has one."""
    if "feedforward" not in oracle:
        return jnp.zeros((steps, joints))
    return jnp.asarray(oracle["feedforward"])[-steps:]


def against(oracle: Any, name: str, found: torque_posterior.Posterior, prior: Prior) -> list[Row]:
    """Compare draws with the oracle: means in its deviations, and ratios of deviations."""
    theta = found.theta.reshape(-1, found.theta.shape[2])
    logs = np.log(found.variances).reshape(-1, found.variances.shape[2])
    p = theta.shape[1]
    n = logs.shape[1] // 3
    mean, sd = np.append(oracle["mean"][:p], oracle["log_s_mean"]), np.append(oracle["sd"][:p], oracle["log_s_sd"])
    both = np.concatenate([theta, logs], axis=1)
    away, ratio = (both.mean(axis=0) - mean) / sd, both.std(axis=0) / sd
    error = np.array([one.mcse / one.sd for one in found.summaries.values()])
    rows = []
    for group, at in (("tau", slice(0, p)), ("log S1", slice(p, p + n)), ("log S3", slice(p + 2 * n, p + 3 * n))):
        worst = int(np.argmax(np.abs(away[at])))
        far = int(np.argmax(np.abs(np.log(ratio[at]))))
        rows.append(Row(f"{group}: mean, farthest from the oracle", f"{name}, entry {worst + 1}",
                        float(away[at][worst]), "oracle sd", float(error[at][worst]), n))  # fmt: skip
        rows.append(
            Row(f"{group}: sd over the oracle's, farthest", f"{name}, entry {far + 1}", float(ratio[at][far]), "1", n=n)
        )
    alpha, beta = np.asarray(prior.alpha)[n : 2 * n], np.asarray(prior.beta)[n : 2 * n]
    spread = np.sqrt(polygamma(1, alpha))
    off = (logs[:, n : 2 * n].mean(axis=0) - (np.log(beta) - psi(alpha))) / spread
    wide = logs[:, n : 2 * n].std(axis=0) / spread
    loose = torque_posterior.unidentified(prior, found)[n : 2 * n]
    rows.append(Row("log S2: mean, farthest from its prior", name, float(off[np.argmax(np.abs(off))]), "prior sd", n=n))
    rows.append(
        Row("log S2: sd over its prior's, farthest", name, float(wide[np.argmax(np.abs(np.log(wide)))]), "1", n=n)
    )
    rows.append(Row("log S2: reported as not identified", name, float(sum(loose)), f"of {n}"))
    return rows


def scatter(oracle: Any, params: Any, data: Data, seed: int) -> list[Row]:
    """Estimate the log-likelihood again and again, with 16 guided particles, at draws of the oracle."""
    p = params.prior.low.shape[0]
    places = oracle["draws"][:: max(len(oracle["draws"]) // 40, 1)]
    if not np.all(places[:, p:] > 0):
        raise SystemExit("oracle: draws of the variances are not positive")
    unknown = Unknown(jnp.asarray(places[:, :p]), jnp.asarray(places[:, p:]))
    model = torque_model.constant(p)
    found = particle_mh.log_likelihoods(model, params, data, unknown, key=jax.random.key(seed + 3))
    sd = np.asarray(found).std(axis=1, ddof=1)
    condition = f"16 guided particles, {found.shape[1]} estimates at each of {len(sd)} draws of the oracle"
    return [Row("sd of the log-likelihood estimate", condition, float(np.sqrt(np.mean(sd**2))), "1", float(sd.std())),
            Row("sd of the log-likelihood estimate, worst", condition, float(sd.max()), "1")]  # fmt: skip


def measure(oracle: Any, robot: Any, name: str, params: Any, data: Data, given: argparse.Namespace) -> list[Row]:
    """Run one sampler until it has the effective draws asked for."""
    model = torque_model.constant(robot.nv)
    begun = time.perf_counter()
    chains = torque_sampler.start(model, params, data, key=jax.random.key(given.seed + 2))
    spread = name in torque_sampler.SPREAD
    go = torque_posterior.advance(torque_sampler.sampler(name, model), params, data, spread=spread)
    kept: list[Any] = []
    while True:
        chains, history = sample(go, chains, PIECE, piece=PIECE)
        kept.append(history)
        whole = jax.tree.map(lambda *x: np.concatenate(x), *kept)
        found = torque_posterior.collect(model, whole, has_path=name != "collapsed")
        draws = min(min(one.bulk, one.tail) for one in found.summaries.values())
        done = PIECE * len(kept)
        say(f"{name}: 4 x {done} iterations, {draws:.0f} effective draws, {time.perf_counter() - begun:.0f} s")
        if draws >= given.draws or done >= given.most:
            break
    every = found.summaries.values()
    condition = f"{name}, 4 x {done} iterations, a quarter discarded"
    rows = [
        Row("R-hat, largest", condition, max(one.r_hat for one in every), "1"),
        Row("bulk effective draws, least", condition, min(one.bulk for one in every), "1"),
        Row("tail effective draws, least", condition, min(one.tail for one in every), "1"),
        Row("acceptance", condition, found.accepted, "1"),
        Row("run time", condition, time.perf_counter() - begun, "s"),
    ]
    if name != "collapsed":
        rows.append(Row("path update rate, least over time", condition, float(found.updates.mean(axis=0).min()), "1"))
    return [*against(oracle, name, found, params.prior), *rows]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("oracle", type=Path, nargs="+", help="files of known posteriors")
    parser.add_argument("--samplers", nargs="*", choices=torque_sampler.SAMPLERS, default=SAMPLERS)
    parser.add_argument("--draws", type=float, default=1000, help="effective draws to wait for")
    parser.add_argument("--most", type=int, default=20000, help="iterations of a chain at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", help="MJCF or URDF; the packaged left arm of Baxter if left out")
    parser.add_argument("--devices", type=int, default=1, help="into how many the processor is split")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    jax.config.update("jax_num_cpu_devices", given.devices)
    jax.config.update("jax_enable_x64", True)
    robot = kinematics.load(given.robot or models.path("baxter_left_arm"))
    rows: list[Row] = []
    for file in given.oracle:
        oracle = dict(np.load(file, allow_pickle=False))
        data, prior = problem(oracle)
        say(f"{file.name}: warm-up")
        key = jax.random.key(given.seed)
        params = torque_sampler.tune(torque_model.constant(robot.nv), robot, prior, data, key=key)
        for name in ("", *given.samplers):
            made = (
                measure(oracle, robot, name, params, data, given) if name else scatter(oracle, params, data, given.seed)
            )
            rows += made
            for row in made if not given.json else ():
                spread = "" if row.spread is None else f" +- {row.spread:.2g}"
                print(f"{row.metric:42s} {row.condition:50s} {row.value:9.4g}{spread} {row.unit}", flush=True)
    if given.json:
        print(to_json(report("torque", rows)))


if __name__ == "__main__":
    main()
