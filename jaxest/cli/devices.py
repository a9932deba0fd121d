"""`--devices N`: the processor as several JAX devices; `--join`: several processes, on any hosts, as one."""

import os
import sys
from typing import Annotated

import typer

VARIABLE = "JAX_NUM_CPU_DEVICES"


def _split(count: int | None) -> int | None:
    """Tell JAX before it starts; afterwards it cannot be told any more."""
    if count is None:
        return None
    if "jax" not in sys.modules:
        os.environ[VARIABLE] = str(count)  # read when JAX is imported
        return count
    import jax

    try:
        jax.config.update("jax_num_cpu_devices", count)
    except RuntimeError as error:
        raise typer.BadParameter(f"JAX runs already, on {jax.device_count()} device(s)") from error
    return count


Devices = Annotated[
    int | None,
    typer.Option(
        "--devices",
        min=1,
        callback=_split,
        is_eager=True,  # before `--join`, which starts JAX, in whatever order they are typed
        help="Split the processor into so many devices; chains use all.",
    ),
]


def _join(text: str | None) -> str | None:
    """Wait for the others; JAX is told before anything runs."""
    if text is None:
        return None
    from jaxest.parallel import hosts
    from jaxest.types import InputError

    try:
        place = hosts.parse(text)
        # Gloo prints to standard output, which belongs to the answer: what is not Python's goes to standard error.
        sys.stdout.flush()
        sys.stdout = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)
        hosts.start(*place)
    except InputError as error:
        raise typer.BadParameter(str(error)) from error
    return text


Join = Annotated[
    str | None,
    typer.Option(
        callback=_join,
        help="One process of several: HOST:PORT,RANK/COUNT with the address of the first, or auto under Slurm.",
    ),
]
