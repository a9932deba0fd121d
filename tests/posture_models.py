"""Small posture estimators for the contract: IMU pairs on a packaged arm, by themselves and behind its joints."""

from functools import partial

import numpy as np

from jaxest import kinematics, models
from jaxest.filters import complementary, pair
from jaxest.systems import posture, posture_pairs
from jaxest.types import System

IMUS = ("site:imu2", "site:imu3", "hand")
EDGES = ((0, 1), (1, 2), (0, 2))


def robot():
    return kinematics.load(models.path("arm"))


def drawn(system, mounting, params, *, key, steps, magnetic=True):
    """What the system of the arm draws, for a filter whose parameters are gains alone."""
    given = system.default_params._replace(filter=params, mounting=mounting.astype(np.asarray(params[0]).dtype))
    return system.simulate(given, key=key, steps=steps)


def pairs(magnetic=True):
    """The pair filter alone, its edges forming a loop."""
    init, step = pair.over(EDGES, len(IMUS))
    of_arm = posture_pairs.build(robot(), IMUS, EDGES, magnetic=magnetic)
    mounting = np.tile([1.0, 0, 0, 0], (3, 1))
    return System(complementary.Params(0.8, 0.05, 1.0, 0.7), init, step, partial(drawn, of_arm, mounting))


def fused(magnetic=False):
    """The arm's joints from two IMUs with headings of their own."""
    system = posture.build(robot(), IMUS[:2], magnetic=magnetic, filter=complementary, iterations=1)
    # Headings that are quite unknown cost digits, and equality is to rounding.
    given = system.default_params._replace(initial_heading=0.05, prior=0.1, memory=0.05)
    return system._replace(default_params=given)


def paired():
    """The arm's joints from pairs of IMUs."""
    return posture_pairs.build(robot(), IMUS, EDGES, magnetic=True, iterations=1)
