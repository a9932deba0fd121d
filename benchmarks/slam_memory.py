"""Memory of a live whole-body SLAM over ten minutes: one simulated minute, forwards and backwards, step by step.

`python benchmarks/slam_memory.py [LINKS] [WORK]`: links 5, 10 or 20; a folder that keeps the simulation. Linux.
"""

import resource
import sys
from pathlib import Path

import jax

from jaxest.reproduce.iwao2025 import runs
from jaxest.reproduce.iwao2025.conditions import condition

MINUTES, STEPS = 10, 600


def resident() -> float:
    """Return this process's resident memory, MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def main() -> None:
    """Print a line a minute."""
    links = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    one, plan = condition(f"{links} links"), runs.Plan(700, 60.0)
    made = runs.simulated(one, plan, Path(sys.argv[2]) if len(sys.argv) > 2 else None)
    _, system = runs.system(links, one.rows, one.columns)
    given, params = runs.measurements(one, plan, made), runs.told(one, system.default_params)
    step, state = jax.jit(system.step), system.init(params)
    for minute in range(MINUTES):
        for k in range(STEPS):
            at = k if minute % 2 == 0 else STEPS - 1 - k
            state, info = step(params, state, jax.tree.map(lambda x, at=at: x[at], given))
        jax.block_until_ready(state)
        print(f"{minute + 1} min: {resident():.1f} MiB resident, {int(info.voxels)} voxels, {int(info.overflow)} lost")


if __name__ == "__main__":
    main()
