"""Live use: samples from a queue, a UDP port, a growing file or a pipe through an estimator's step, against a deadline.

Start with `drive(step, params, state, source, template)`; a source is `from_queue`, `from_udp`, `from_file` or
`from_stream`, or any iterator of `Sample`s. Late samples are refused and counted, absent ones are masked, the state is
saved on the way, at the end and when something fails, and `Outcome.latency` is the histogram of what each step took.

Host side only. Not here: the estimators (`jaxest.systems`), and recorded logs, for which `jaxest.filters.run` is the
faster way.
"""

from jaxest.live.compiled import Program, program
from jaxest.live.keeper import Checkpoint, resume
from jaxest.live.latency import EDGES, Latency
from jaxest.live.loop import Outcome, drive
from jaxest.live.measure import measurement_of
from jaxest.live.sources import IDLE, Sample, from_file, from_queue, from_stream, from_udp, parse

__all__ = [
    "EDGES",
    "IDLE",
    "Checkpoint",
    "Latency",
    "Outcome",
    "Program",
    "Sample",
    "drive",
    "from_file",
    "from_queue",
    "from_stream",
    "from_udp",
    "measurement_of",
    "parse",
    "program",
    "resume",
]
