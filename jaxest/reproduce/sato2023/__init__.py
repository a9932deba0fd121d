"""Sato 2023 (self-body deflection): its figures and the studies of section V-A.

Table I's values throughout; the arm is the packaged one, bent as eq. 31 says with its erratum's sign. The paper's
curves come from a robot that nobody else has, so most rows have no figure of the paper's to stand beside.
"""

from collections.abc import Mapping

from jaxest.reproduce import Part
from jaxest.reproduce.sato2023 import drift, fusion, hand, shapes, studies

PARTS: Mapping[str, Part] = {
    "fig1": shapes.fig1,
    "fig2": shapes.fig2,
    "fig3": shapes.fig3,
    "fig6": fusion.fig6,
    "fig8": hand.fig8,
    "fig9": hand.fig9,
    "fig10": drift.fig10,
    "particles": studies.particles,
    "hyperparameters": studies.hyperparameters,
}
"""By the name that `--part` takes."""

__all__ = ["PARTS"]
