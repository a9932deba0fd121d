"""The conditions of Table II: what is simulated, what the filter is told, and what the paper says."""

from collections.abc import Mapping
from typing import NamedTuple

from jaxest.types import unknown_name


class Condition(NamedTuple):
    """A row of the table."""

    name: str
    links: int = 20
    columns: int = 8
    """Zones of a sensor around its link."""
    rows: int = 8
    """Zones of a sensor along its link."""
    noise: float = 0.01
    """Alpha."""
    tilt_deg: float = 0.0
    """Sensors are turned about random axes by angles drawn up to this."""
    paper: Mapping[int, tuple[float, float]] = {}
    """Mean and standard deviation in cm, by link."""
    kinematics: Mapping[int, float] = {}
    """The paper's error of the kinematic model, cm."""


KIN = {5: 5.4, 10: 22.8, 20: 90.0}
TABLE = (
    Condition("20 links", paper={5: (5.0, 0.8), 10: (4.3, 0.9), 20: (5.3, 1.6)}, kinematics=KIN),
    Condition("10 links", 10, paper={5: (5.9, 1.5), 10: (6.9, 2.5)}, kinematics={10: 33.9}),
    Condition("5 links", 5, paper={5: (4.0, 3.2)}, kinematics={5: 12.5}),
    Condition("256 points", columns=4, paper={5: (4.0, 1.3), 10: (4.9, 1.9), 20: (8.6, 4.0)}),
    Condition("128 points", columns=4, rows=4, paper={5: (3.1, 1.3), 10: (4.5, 1.6), 20: (9.8, 5.1)}),
    Condition("2 % noise", noise=0.02, paper={5: (3.4, 0.9), 10: (4.5, 1.4), 20: (7.8, 3.2)}),
    Condition("5 % noise", noise=0.05, paper={5: (5.2, 2.2), 10: (6.7, 4.6), 20: (11.5, 11.0)}),
    Condition("7 % noise", noise=0.07, paper={5: (6.5, 2.6), 10: (8.4, 3.7), 20: (20.5, 13.2)}),
    Condition("2 deg tilt", tilt_deg=2.0, paper={5: (4.3, 1.3), 10: (4.3, 1.7), 20: (6.4, 3.2)}),
    Condition("3 deg tilt", tilt_deg=3.0, paper={5: (4.4, 1.1), 10: (4.2, 1.2), 20: (4.0, 2.1)}),
    Condition("5 deg tilt", tilt_deg=5.0, paper={5: (3.9, 1.1), 10: (4.3, 1.7), 20: (7.6, 7.5)}),
)
"""Source: Iwao 2025, Table II. Errata: its row "56" is a copy of the 2 % row, and "kinematic model, 10-link, Link 5" a
copy of the method's row; both are left out."""
CHAIN = "paper's filter"
"""Name of the row that runs the paper's own filter on the rooms of the first."""
NAMES = (*(one.name for one in TABLE), CHAIN)


def chosen(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the rows asked for, in the table's order; raises InputError for an unknown name."""
    for name in names:
        if name not in NAMES:
            raise unknown_name("row", name, NAMES)
    return tuple(name for name in NAMES if not names or name in names)


def condition(name: str) -> Condition:
    """Return a row; the paper's own filter runs on the first."""
    return next((one for one in TABLE if one.name == name), TABLE[0])


__all__ = ["CHAIN", "NAMES", "TABLE", "Condition", "chosen", "condition"]
