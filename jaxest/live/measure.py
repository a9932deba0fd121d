"""From a sample to the measurement of an estimator's step."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxest.live.sources import Sample
from jaxest.types import InputError, PyTree, Reading, unknown_name


def fields(template: PyTree) -> tuple[str, ...]:
    """Return which streams a measurement takes: the names of its `Reading`s.

    Args:
        template: a measurement (NamedTuple) with values of the right shapes.

    Returns:
        Names in the measurement's order.
    """
    return tuple(name for name in template._fields if isinstance(getattr(template, name), Reading))


def measurement_of(template: PyTree, sample: Sample, dt: float) -> PyTree:
    """Put a sample into a measurement; a stream that is absent, null or not finite is masked.

    Args:
        template: a measurement of the step, NumPy arrays of the right shapes and dtypes; its other fields are kept.
        sample: the sample; values of streams that the measurement does not take are an error.
        dt: s, since the step before.

    Returns:
        The measurement, NumPy arrays.

    Raises:
        InputError: a stream is unknown (the closest name is given) or has another shape, or values have no names.
    """
    known = fields(template)
    if not isinstance(sample.values, Mapping):
        found = type(sample.values).__name__
        raise InputError(
            f"sample at {sample.time:.6f} s: values: got {found}, expected a value for each stream by name"
        )
    for name, value in sample.values.items():
        if name not in known and value is not None:
            raise InputError(f"sample at {sample.time:.6f} s: {unknown_name('stream', name, known)}")
    with np.errstate(over="ignore"):  # too large for the dtype: not finite, hence masked
        readings = {
            name: _reading(getattr(template, name), sample.values.get(name), name, sample.time) for name in known
        }
    return template._replace(**readings, dt=np.asarray(dt, np.asarray(template.dt).dtype))


def _reading(like: Reading, value: Any, name: str, stamp: float) -> Reading:
    """Few calls of NumPy where all is well: at 1 kHz each costs a thousandth of the deadline."""
    expected, valid = np.asarray(like.value), np.asarray(like.valid)
    if value is None:
        return Reading(np.zeros(expected.shape, expected.dtype), np.zeros(valid.shape, bool))  # type: ignore[arg-type]
    try:
        found = np.array(value, expected.dtype)  # a copy: a sender may use its array again
    except (ValueError, TypeError, OverflowError):
        found = None
    if found is None or found.shape != expected.shape:
        came = "ragged or no numbers" if found is None else f"shape {found.shape}"
        raise InputError(f"sample at {stamp:.6f} s: stream {name!r} is of {came}, expected {expected.shape}")
    finite = np.isfinite(found)
    if finite.all():
        return Reading(found, np.ones(valid.shape, bool))  # type: ignore[arg-type]
    there = finite.all(axis=tuple(range(valid.ndim, found.ndim)))
    return Reading(np.where(finite, found, 0), np.asarray(there, bool))  # type: ignore[arg-type]


__all__ = ["fields", "measurement_of"]
