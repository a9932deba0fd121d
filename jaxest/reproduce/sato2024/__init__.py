"""Sato 2024 (on-site kinematics): its figures 5, 8 and 9, and section V-B.

Simulated: the rod by sums of sines, the manipulator in MuJoCo. The paper's robot has figures of its own only where
they are given in the text; those stand beside ours.
"""

from collections.abc import Mapping

from jaxest.reproduce import Part
from jaxest.reproduce.sato2024 import frequency, reach, rod

PARTS: Mapping[str, Part] = {
    "fig5": rod.fig5,
    "noise": rod.noise,
    "fig8": reach.fig8,
    "fig9": frequency.fig9,
    "motion": rod.motion,
}
"""By the name that `--part` takes; `noise` is the rod at the noise of the paper's sensors and three times it, `motion`
section V-B."""
TAKES = ("runs",)

__all__ = ["PARTS", "TAKES"]
