"""Logs, checkpoints, reports and configs, on the host.

* `read(path)` gives a `SensorLog`: streams by name, each with float64 stamps, values, unit and frame; `write(log,
  path)` writes one. NPZ, CSV, Parquet and HDF5, jaxest's own and other people's; MCAP and TUM. ROS bags and LeRobot
  datasets are read only. `bags.read` offers the bag's clock, chosen topics and what is readable of a broken bag.
* Somebody else's layout: `propose(path)` guesses the `[columns]` table, `to_toml` prints it, `read(path, columns)`
  uses it.
* `ticks(log)` merges streams of different rates into one sequence of steps without losing a sample; `interpolate`
  puts them on stamps of your own.
* `summarize(log)` says what is in a log and what looks wrong; `to_si` converts the units that its streams state.
* `save_state`, `load_state`: a checkpoint of any state pytree; `Report`, `to_json`: what commands print; `read_config`,
  `write_config`.

Streams are called `gyroscope`, `accelerometer`, `magnetometer` (T), `orientation` (wxyz), `joint_position`, ...;
several sensors of a kind have a prefix, `imu0/gyroscope`. NaN stays in a log as a missing sample.
"""

from jaxest.io.align import Steps, interpolate, ticks
from jaxest.io.checkpoint import load_state, save_state
from jaxest.io.columns import Column, ColumnTable
from jaxest.io.config import read_config, write_config
from jaxest.io.formats import propose, read, write
from jaxest.io.inspect import Summary, summarize
from jaxest.io.log import SensorLog, Stream, check, stream, to_si
from jaxest.io.proposal import Proposal
from jaxest.io.report import Environment, Report, Row, environment, to_json
from jaxest.io.table_text import to_toml

__all__ = [
    "Column",
    "ColumnTable",
    "Environment",
    "Proposal",
    "Report",
    "Row",
    "SensorLog",
    "Steps",
    "Stream",
    "Summary",
    "check",
    "environment",
    "interpolate",
    "load_state",
    "propose",
    "read",
    "read_config",
    "save_state",
    "stream",
    "summarize",
    "ticks",
    "to_json",
    "to_si",
    "to_toml",
    "write",
    "write_config",
]
