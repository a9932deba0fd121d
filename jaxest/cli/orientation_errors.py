"""How wrong an orientation is against a truth: the rows that `estimate`, `compare` and `demo` print."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io.report import Row
from jaxest.types import InputError

CHI_2_95 = {2: 5.991465, 3: 7.814728}  # 95 % quantiles of chi-square


def rows(
    quaternion: NDArray[Any],
    truth: NDArray[Any],
    *,
    covariance: NDArray[Any] | None = None,
    movement: NDArray[Any] | None = None,
    heading: bool = True,
    condition: str = "",
    place: str = "truth",
) -> list[Row]:
    """Return the errors as BROAD measures them, and whether the estimate knows them.

    Args:
        quaternion: (T, 4) wxyz, sensor to earth.
        truth: (T, 4) wxyz at the same times, NaN where unknown.
        covariance: (T, 3, 3) rad2, perturbation on the right; adds NEES and coverage.
        movement: (T,) bool, the samples that count; None means all.
        heading: whether the estimate claims a heading at all; without it only the inclination is judged.
        condition: goes into every row.
        place: what to name in the error.

    Returns:
        Root-mean-square errors in degrees over the samples that count; mean NEES (degrees of freedom as `reference`)
        and the share of samples inside the 95 % ellipsoid.

    Raises:
        InputError: there is no sample to judge.
    """
    from jaxest.metrics import broad_rmse_deg

    quaternion, truth = np.asarray(quaternion, np.float64), np.asarray(truth, np.float64)
    moving = np.ones(len(truth), bool) if movement is None else np.asarray(movement, bool)
    counts = moving & np.isfinite(truth).all(axis=-1)
    n = int(counts.sum())
    if n == 0:
        raise InputError(f"{place}: no sample is both known and moving, expected at least one to compare with")
    parts = broad_rmse_deg(quaternion, truth, moving)
    names = ("total", "heading", "inclination") if heading else ("inclination",)
    made = [Row(f"{name} RMSE", condition, float(getattr(parts, name)), "deg", n=n) for name in names]
    if covariance is not None:
        made += _consistency(quaternion[counts], truth[counts], covariance[counts], heading, condition)
    return made


def _consistency(
    quaternion: NDArray[Any], truth: NDArray[Any], covariance: NDArray[Any], heading: bool, condition: str
) -> list[Row]:
    from jaxest.metrics import nees, orientation_difference

    covariance = np.asarray(covariance, np.float64)
    quaternion = quaternion if heading else _same_heading(quaternion, truth)
    error = orientation_difference(quaternion, truth)
    if not heading:
        error, covariance = _horizontal(quaternion, error, covariance)
    dof = error.shape[-1]
    value = nees(error, covariance)
    known = np.isfinite(value)
    n = int(known.sum())
    if n == 0:
        return []
    part = "orientation" if heading else "inclination"
    inside = 100 * float(np.mean(value[known] <= CHI_2_95[dof]))
    expected: Any = {"n": n, "reference_name": "consistent"}
    return [
        Row(f"{part} NEES", condition, float(np.mean(value[known])), "1", reference=float(dof), **expected),
        Row(f"{part} inside 95 %", condition, inside, "%", reference=95.0, **expected),
    ]


def _same_heading(quaternion: NDArray[Any], truth: NDArray[Any]) -> NDArray[Any]:
    """Turn estimates about the vertical until the error that remains has a horizontal axis."""
    (a, b, c, d), (e, f, g, h) = np.moveaxis(quaternion, -1, 0), np.moveaxis(truth, -1, 0)
    half = -np.arctan2(d * e - a * h - b * g + c * f, a * e + b * f + c * g + d * h)  # z and w of quaternion / truth
    w, z = np.cos(half), np.sin(half)
    return np.stack([w * a - z * d, w * b - z * c, w * c + z * b, w * d + z * a], axis=-1)


def _horizontal(
    quaternion: NDArray[Any], error: NDArray[Any], covariance: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Turn errors into the earth frame and keep the two horizontal components."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        ],
        axis=-2,
    )
    return np.einsum("tij,tj->ti", rows, error), np.einsum("tij,tjk,tlk->til", rows, covariance, rows)
