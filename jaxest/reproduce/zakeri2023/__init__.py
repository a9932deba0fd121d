"""Zakeri 2023 (joint torques by particle MCMC): its table, its figures, and what its samplers really do.

Only the table of particle Gibbs and the means of Fig. 2 survive in the paper; its data do not. The data here are drawn
anew with the paper's torques and variances, in one of three settings (`--setting paper`, `mild` or `reachable`).
"""

from collections.abc import Mapping

from jaxest.reproduce import Part
from jaxest.reproduce.zakeri2023 import figures, studies

PARTS: Mapping[str, Part] = {
    "table1": figures.table1,
    "fig1": figures.fig1,
    "fig2": figures.fig2,
    "collapsed": figures.collapsed,
    "baselines": studies.baselines,
    "starts": studies.starts,
    "particles": studies.particles,
    "accuracy": studies.accuracy,
}
"""By the name that `--part` takes."""
TAKES = ("runs", "setting", "work")

__all__ = ["PARTS", "TAKES"]
