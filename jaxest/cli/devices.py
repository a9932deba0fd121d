"""`--devices N`: the processor as several JAX devices, for what spreads over them."""

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
    typer.Option("--devices", min=1, callback=_split, help="Split the processor into so many devices; chains use all."),
]
