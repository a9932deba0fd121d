"""A step compiled for one call after another, where a call costs more than its arithmetic.

Two things are done about that. State, measurement and info each travel as one vector of words: every array in or out of
a call costs one or two microseconds. And where the program is small and XLA's CPU compiler can, all of it becomes one
kernel: a step of 64 guided particles is otherwise 150 of them, each started, and each with buffers of its own. XLA
compiles a call so that has the attribute `xla_cpu_small_call`, as it does itself with short loops.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.xla_metadata import set_xla_metadata
from numpy.typing import NDArray

from jaxest.live.words import Layout, layout
from jaxest.types import Array, PyTree, Step

LARGEST = 2**16  # entries of an array; from about there several threads are quicker
PRODUCT = 2**16  # multiplications in a matrix product; plain loops are slower than the library's from there
NO_LIBRARY = {"xla_cpu_experimental_ynn_fusion_type": ""}
ONE_KERNEL = ({"xla_cpu_use_fusion_emitters": False, **NO_LIBRARY}, NO_LIBRARY)
"""Options by which XLA makes no fusions that a kernel cannot contain: with JAX 0.10; with 0.11, for most programs."""
ABLE = frozenset(
    """abs add and atan2 bitcast_convert broadcast_in_dim case cbrt ceil clamp compare concatenate constant convert
    cosine count_leading_zeros divide dot_general dynamic_slice dynamic_update_slice erf erf_inv erfc exponential
    exponential_minus_one floor gather if iota is_finite is_inf is_neg_inf is_pos_inf lgamma log log_plus_one logistic
    maximum minimum multiply negate next_after not optimization_barrier or pad popcnt power reduce reduce_window
    remainder reshape return reverse round_nearest_afz round_nearest_even rsqrt scatter select shift_left
    shift_right_arithmetic shift_right_logical sign sine slice sqrt square subtract tan tanh transpose while
    xor""".split()  # noqa: SIM905
)
"""Operations of which XLA makes one kernel; sorting and LAPACK, for example, are functions that it calls."""


class Program(NamedTuple):
    """A compiled step: `call(carry, measurement) -> (carry, info)`."""

    start: Callable[[PyTree], Any]
    """What to carry from call to call, from a state."""
    call: Callable[[Any, PyTree], tuple[Any, PyTree]]
    """One step, finished when it returns; NumPy arrays in and, as info, out. ValueError: an array of another shape."""
    state: Callable[[Any], PyTree]
    """The state in what is carried."""
    one_kernel: bool
    """Whether the whole step is one kernel of the CPU."""


def program(step: Step, params: PyTree, state: PyTree, template: PyTree, *, key: Array | None = None) -> Program:
    """Compile a step for a loop that takes one measurement after another.

    Args:
        step: an estimator's step.
        params: its parameters; they become constants of the program.
        state: of the estimator; shapes and dtypes count.
        template: a measurement of the step, NumPy arrays of the right shapes and dtypes.
        key: key of the whole run, for steps that draw.

    Returns:
        The program; its numbers are those of `jaxest.filters.run`, to rounding.
    """
    params = jax.tree.map(jnp.asarray, params)  # constants: a call costs microseconds for every array it is given
    template = jax.tree.map(_canonical, template)

    @jax.jit  # traced once, though three times called
    def stepped(state: PyTree, measurement: PyTree) -> tuple[PyTree, PyTree]:
        return step(params, state, measurement, key=key)

    after, info = jax.eval_shape(stepped, state, template)
    layouts = layout(after), layout(info), layout(template)
    started = partial(jax.tree.map, lambda x, like: jnp.asarray(x, like.dtype))  # not weakly typed: one program
    if any(one is None or one.words > LARGEST for one in layouts):

        def called(state: PyTree, measurement: PyTree) -> tuple[PyTree, PyTree]:
            state, info = jax.block_until_ready(stepped(state, measurement))
            return state, jax.tree.map(np.asarray, info)

        return _warm(Program(lambda state: started(state, after), called, lambda state: state, False), state, template)
    return _in_words(stepped, *layouts, started(state, after), template)  # type: ignore[arg-type]


def _in_words(
    stepped: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]],
    states: Layout, infos: Layout, measurements: Layout, state: PyTree, template: PyTree,
) -> Program:  # fmt: skip
    """The program whose carry is one array: the words of the state, and behind them those of the info."""

    def advance(words: Array, measurement: Array) -> Array:
        state, info = stepped(states.unpack(words[: states.words]), measurements.unpack(measurement))
        return jnp.concatenate([states.pack(state), infos.pack(info)])

    def start(state: PyTree) -> Array:
        return jnp.pad(states.pack(state), (0, infos.words))

    begin = jax.jit(start)
    compiled, one_kernel = _compiled(advance, begin(state), measurements.write(template))

    def call(words: Array, measurement: PyTree) -> tuple[Array, PyTree]:
        words = compiled(words, measurements.write(measurement))
        found = np.asarray(words)[states.words :].copy()  # waits for it; whoever keeps an info keeps no state with it
        return words, infos.read(found)

    def unpacked(words: Array) -> PyTree:
        return jax.tree.map(jnp.asarray, states.read(np.asarray(words)[: states.words]))

    return _warm(Program(begin, call, unpacked, one_kernel), state, template)


def _warm(program: Program, state: PyTree, template: PyTree) -> Program:
    """Call it once, so that nothing is compiled later."""
    program.call(program.start(state), template)
    return program


def _compiled(
    advance: Callable[..., Array], carry: Array, heard: NDArray[np.uint32]
) -> tuple[Callable[..., Array], bool]:
    """Compile; whether it is one kernel."""
    inner = jax.jit(advance)
    cpu = all(device.platform == "cpu" for device in carry.devices())
    if cpu and is_small(inner.lower(carry, heard).as_text()):
        # The attributes go to the call that makes the value: XLA is not to inline it, and to make one kernel of it.
        marks = {"xla_cpu_small_call": "true", "inlineable": "false"}
        for options in ONE_KERNEL:
            one = jax.jit(lambda *words: set_xla_metadata(inner(*words), **marks), compiler_options=options)
            with contextlib.suppress(jax.errors.JaxRuntimeError):  # another version of XLA
                jax.block_until_ready(one(carry, heard))
                return one, True
    return inner, False


def is_small(text: str) -> bool:
    """Return whether a program is one that XLA can make a single kernel of, and should.

    Args:
        text: the program in StableHLO.

    Returns:
        Whether it has only operations of `ABLE`, no array above `LARGEST` and no product above `PRODUCT`.
    """
    if set(re.findall(r"\b(?:stablehlo|chlo)\.(\w+)", text)) - ABLE:
        return False
    sizes = {
        shape: math.prod(map(int, re.findall(r"\d+(?=x)", shape)))
        for shape in set(re.findall(r"tensor<([^>]*)>", text))
    }
    products = re.findall(r"dot_general .*: \(tensor<(.*?)>, tensor<(.*?)>\) -> tensor<(.*?)>", text)
    work = (math.sqrt(math.prod(sizes[shape] for shape in one)) for one in products)  # at least
    return max(sizes.values(), default=0) <= LARGEST and all(one <= PRODUCT for one in work)


def _canonical(x: Any) -> NDArray[Any]:
    x = np.asarray(x)
    return x.astype(jax.dtypes.canonicalize_dtype(x.dtype))


__all__ = ["Program", "program"]
