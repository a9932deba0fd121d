"""One batch axis over devices and processes, by JAX's own engine; nothing here schedules work.

Particles, chains, recordings, simulations and parameter sets are leading axes that `vmap` adds. `shards` spreads such
an axis over all devices, of this process or, after `start`, of all of them; the same numbers come out as on one device.
`gather` brings results to every host. `jaxest.io.studies.study` does it a piece at a time and writes each down, so that
a run that was stopped goes on.

The particles of one filter are no independent items: `particles.filter_step(model)` spreads those.
"""

from jaxest.parallel import particles
from jaxest.parallel.devices import Spread, everywhere, gather, mesh, one_by_one, several, shards
from jaxest.parallel.hosts import Place, from_first, start, together

__all__ = [
    "Place",
    "Spread",
    "everywhere",
    "from_first",
    "gather",
    "mesh",
    "one_by_one",
    "particles",
    "several",
    "shards",
    "start",
    "together",
]
