"""What `import jaxest` costs over `import jax`, each in a fresh interpreter."""

import subprocess
import sys
from collections.abc import Callable, Iterable

import numpy as np

from jaxest.bench.harness import Candidate, Progress, compare, race
from jaxest.io.report import Row

SUBPACKAGES = (
    "calibration", "derivatives", "distributions", "filters", "io", "kinematics", "live", "manifolds", "mapping",
    "mcmc", "metrics", "models", "parallel", "sensors", "simulate", "systems", "tuning", "types",
)  # fmt: skip
"""All that a program may import without a backend; host-side `bench`, `cli`, `reproduce`, `viz` are not among them."""


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time whole interpreters, so that nothing is loaded already.

    Args:
        peers: `import jax` is measured in any case; without it the figure means nothing.
        progress: hears what is being measured.
        small: one round instead of nine.

    Yields:
        Of jaxest alone, of each subpackage, and of all of them: the whole interpreter's time beside that of
        `import jax`, Python's own start in both, and the median difference within a round.
    """
    del peers
    progress("importing in fresh interpreters")
    whole = {
        "jaxest": "import jax, jaxest",
        "jaxest and its subpackages": "import jax; from jaxest import " + ", ".join(SUBPACKAGES),
    }
    each = {} if small else {f"jaxest.{name}": f"import jax, jaxest.{name}" for name in SUBPACKAGES}
    for programs, repeats in ((whole, 1 if small else 7), (each, 2)):
        candidates = [Candidate(name, _importer(code)) for name, code in programs.items()]
        if not candidates:
            continue
        timings = race([Candidate("import jax", _importer("import jax")), *candidates], repeats=repeats, min_time=0.0)
        alone = timings.pop("import jax")
        for name, timing in timings.items():
            yield compare("import", f"{name}, fresh interpreter", timing, alone, unit="s")
            over = timing.seconds - alone.seconds
            yield Row("over import jax", name, float(np.median(over)), "s", n=len(over))


def _importer(code: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
