"""What `import jaxest` costs over `import jax`, each in a fresh interpreter."""

import subprocess
import sys
from collections.abc import Callable, Iterable

from jaxest.bench.harness import Candidate, Progress, compare, race
from jaxest.io.report import Row

SUBPACKAGES = ("filters", "io", "kinematics", "manifolds", "metrics", "models", "simulate", "systems", "types")


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time whole interpreters, so that nothing is loaded already.

    Args:
        peers: `import jax` is measured in any case; without it the figure means nothing.
        progress: hears what is being measured.
        small: one round instead of nine.

    Yields:
        One row for `import jax` and one for jaxest with all subpackages, both with Python's own start.
    """
    del peers
    progress("importing in fresh interpreters")
    everything = "from jaxest import " + ", ".join(SUBPACKAGES)
    timings = race(
        [Candidate("import jax", _importer("import jax")), Candidate("import jaxest", _importer(everything))],
        repeats=1 if small else 9,
        min_time=0.0,
    )
    jax_alone, ours = timings["import jax"], timings["import jaxest"]
    yield compare("import", "jaxest and its subpackages, fresh interpreter", ours, jax_alone, unit="s")


def _importer(code: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, "-c", code], check=True, stdout=subprocess.DEVNULL)
