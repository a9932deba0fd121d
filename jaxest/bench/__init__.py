"""How fast it is: timings of jaxest beside other programs, in the same run.

`rows("orientation")` runs one case and yields `jaxest.io.report.Row`s; `jaxest bench NAME` prints them. A case is a
module with a function `rows`, named in `CASES` and loaded on first use; `jaxest.bench.harness` holds what cases are
made of (`candidate`, `race`, `compare`). A peer that is not installed costs its ratio and nothing else.

Not here: accuracy, which is tested in `tests/` and measured on recordings by the scripts in `benchmarks/`.
"""

import importlib
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from jaxest.types import InputError, listed

if TYPE_CHECKING:
    from jaxest.io.report import Row

CASES = {
    "bingham": "jaxest.bench.bingham",
    "deflection": "jaxest.bench.deflection",
    "dynamics": "jaxest.bench.dynamics",
    "import": "jaxest.bench.import_time",
    "inverse_kinematics": "jaxest.bench.inverse_kinematics",
    "kalman": "jaxest.bench.kalman",
    "kinematics": "jaxest.bench.kinematics",
    "live": "jaxest.bench.live",
    "logs": "jaxest.bench.logs",
    "onsite": "jaxest.bench.onsite",
    "orientation": "jaxest.bench.orientation",
    "posture": "jaxest.bench.posture",
    "rls": "jaxest.bench.rls",
    "savitzky_golay": "jaxest.bench.savitzky_golay",
    "scaling": "jaxest.bench.scaling",
    "slam": "jaxest.bench.slam",
    "torque": "jaxest.bench.torque",
}
"""Name of a case, and the module that holds it."""


def rows(
    name: str,
    *,
    peers: bool = True,
    progress: Callable[[str], None] | None = None,
    small: bool = False,
    robots: Sequence[str] = (),
    peer_seconds: float | None = None,
) -> Iterable["Row"]:
    """Run one case.

    Args:
        name: one of `CASES`.
        peers: whether to run other programs beside it.
        progress: hears what is being measured.
        small: sizes that a test can afford; the figures mean nothing then.
        robots: MJCF or URDF files to measure beside the packaged ones, where the case is about robots.
        peer_seconds: how long each other program runs, where the case is about samplers.

    Returns:
        The rows, one at a time as they are measured.

    Raises:
        InputError: the name is unknown.
    """
    if name not in CASES:
        raise InputError(f"benchmark {name!r} does not exist, expected one of {listed(CASES)}")
    if robots and name not in ("dynamics", "inverse_kinematics", "kinematics"):
        raise InputError(f"benchmark {name!r} is not about robots, got {', '.join(robots)}")
    if peer_seconds is not None and name != "torque":
        raise InputError(f"benchmark {name!r} runs no sampler for a given time, got {peer_seconds:g} s")
    module = importlib.import_module(CASES[name])
    options: dict[str, Any] = {"robots": tuple(robots)} if robots else {}
    options |= {} if peer_seconds is None else {"seconds": peer_seconds}
    return module.rows(peers=peers, progress=progress or (lambda message: None), small=small, **options)


__all__ = ["CASES", "rows"]
