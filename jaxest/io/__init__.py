"""Logs, checkpoints, reports and configs, on the host.

* `read(path)` gives a `SensorLog`: streams by name, each with float64 stamps, values, unit and frame;
  `write(log, path)` writes one. Files: NPZ and CSV, jaxest's own and other people's.
* Somebody else's layout: `propose(path)` guesses the `[columns]` table, `to_toml` prints it, `read(path, columns)`
  uses it.
* `ticks(log)` merges streams of different rates into one sequence of steps without losing a sample; `interpolate`
  puts them on stamps of your own.
"""

from jaxest.io.align import Steps, interpolate, ticks
from jaxest.io.columns import Column, ColumnTable
from jaxest.io.formats import propose, read, write
from jaxest.io.log import SensorLog, Stream, check, stream, to_si
from jaxest.io.proposal import Proposal, to_toml

__all__ = [
    "Column",
    "ColumnTable",
    "Proposal",
    "SensorLog",
    "Steps",
    "Stream",
    "check",
    "interpolate",
    "propose",
    "read",
    "stream",
    "ticks",
    "to_si",
    "to_toml",
    "write",
]
