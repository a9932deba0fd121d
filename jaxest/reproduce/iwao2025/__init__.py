"""Iwao 2025 (whole-body SLAM): Table II and figs. 2 and 4, in rooms drawn from a seed.

`table2` has a row for each condition (`--rows` chooses, `--runs` says how many rooms), `fig2` shows structure, map and
estimate, `fig4` the free structure on the ground, `roll` the paper's filter where the root moves too fast for it.
Simulations and finished runs are kept in `--work`, so that a stopped table goes on and rows share their rooms.
"""

from collections.abc import Mapping

from jaxest.reproduce import Part
from jaxest.reproduce.iwao2025 import free, pictures, table

TAKES = ("runs", "rows", "work")
PARTS: Mapping[str, Part] = {
    "table2": table.table2,
    "fig2": pictures.fig2,
    "fig4": free.fig4,
    "roll": free.roll,
}
"""By the name that `--part` takes."""

__all__ = ["PARTS", "TAKES"]
