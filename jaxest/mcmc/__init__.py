"""Markov chains over parameters and paths of nonlinear state-space models with additive noise.

Write the model once (`Model`, `Prior`, `Data`); `chains.untuned` linearises it along its most probable path,
`chains.settle` or `chains.warm_up` tunes the proposals. Then choose a sampler: `particle_gibbs.guided`,
`particle_mh.guided`, or `kernel.collapsed`, which is the quickest and is exact up to the linearisation;
`full_noise.gibbs` draws whole covariance matrices. Each is a `kernel(params, data, state, *, key) -> (state, info)`;
`chains.advance` drives many chains with `filters.run`.

Start chains from `chains.dispersed` and read `diagnostics.verdict`: one chain cannot see that its path is frozen.
All is float64 here (`JAX_ENABLE_X64=1`), for variances of 1e-7 meet data of size 1.

`particle_gibbs.baseline` and `particle_mh.baseline` are the samplers of Zakeri 2023. Not here: checkpoints and files
(`jaxest.io`), and robots (`jaxest.systems.torque`).
"""

from jaxest.mcmc import (
    chains,
    conditional_smc,
    diagnostics,
    full_noise,
    kernel,
    model,
    particle_gibbs,
    particle_mh,
    twist,
)

__all__ = [
    "chains",
    "conditional_smc",
    "diagnostics",
    "full_noise",
    "kernel",
    "model",
    "particle_gibbs",
    "particle_mh",
    "twist",
]
