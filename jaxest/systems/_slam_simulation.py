"""A robot in an empty box-shaped room, simulated in JAX."""

from typing import Any

from jaxest.systems._slam_body import Body
from jaxest.types import Array


def simulate(body: Body, params: Any, *, key: Array, steps: int = 20) -> Any:
    raise NotImplementedError
