"""An IMU in a block that is turned over on a plate, a quarter turn at a time: what perfect sensors would read.

The counterpart of `jaxest.calibration.tumble`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.calibration.alignment import rotations
from jaxest.calibration.tumble import QUARTERS, G, attitudes, log

REST, TURN = 1.5, 1.2  # s, on a face and between two


class Tumbled(NamedTuple):
    """Attitudes of a block at its rests, and how it moves between them."""

    rests: NDArray[np.float64]
    """(n, 3, 3) case to plate, as the block really lies."""

    @property
    def duration(self) -> float:
        """s, from the beginning of the first rest to the end of the last."""
        return len(self.rests) * REST + (len(self.rests) - 1) * TURN


def draw(random: np.random.Generator, *, flatness: float = 3e-4) -> Tumbled:
    """Turn a block over, four quarters about each of its axes.

    Args:
        random: generator of the attitudes' errors.
        flatness: rad, standard deviation of an attitude at rest about each axis.

    Returns:
        How it moves.
    """
    known = attitudes(QUARTERS)
    return Tumbled(known @ rotations(flatness * random.normal(size=(len(known), 3))))


def ideal(tumbled: Tumbled, time: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return rates (n, 3) rad/s and specific forces (n, 3) m/s2 in the case.

    Args:
        tumbled: the motion, which begins at 0; before and after it rests.
        time: (n,) s.
    """
    count = len(tumbled.rests)
    phase = np.clip(time, 0, tumbled.duration - 1e-9)
    face = np.minimum((phase // (REST + TURN)).astype(int), count - 1)
    share = np.clip((phase - face * (REST + TURN) - REST) / TURN, 0, 1)
    behind = np.minimum(face + 1, count - 1)
    turns = np.array([log(a.T @ b) for a, b in zip(tumbled.rests[face], tumbled.rests[behind], strict=True)])
    angle = share * share * share * (10 - 15 * share + 6 * share * share)  # neither jerks nor jumps
    speed = 30 * share * share * (1 - share) ** 2 / TURN
    attitude = tumbled.rests[face] @ rotations(turns * angle[:, None])
    return turns * speed[:, None], G * attitude[:, 2, :]


__all__ = ["REST", "TURN", "Tumbled", "draw", "ideal"]
