"""How IMUs sit on the links of a joint: its axes in both sensors' frames, found from motion, without a zero posture.

Both IMUs' orientations come first, each by its own filter or smoother and each with a heading of its own. A joint then
says what their rotation R_12 may do: a hinge keeps `j_1 = R_12 j_2`, a joint of two axes keeps the angle between them,
`j_1 . R_12 j_2`. Axes, the angle between the two headings and its drift are what makes that true all along.

Source: the constraints of Seel, Raisch, Schauer 2014 (IMU-based joint angle measurement) and Laidig, Lehmann, Begin,
Seel 2019 (magnetometer-free 2-dof), here on orientations instead of rates: their start is a search over one angle,
with an eigenvalue problem for each, and finds the sign of a hinge's axis as well. With the angular rates (`rates`) the
axes are then found from the integrated rates, ten times more exact where the orientations come from accelerometers.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.calibration import _axes_rates
from jaxest.calibration._axes import Found, Paths, fit_pair, refined, start_hinge, start_pair
from jaxest.calibration._recordings import finite
from jaxest.calibration._rotations import of_quaternions, skew, to_quaternion
from jaxest.types import InputError

LEAST = np.deg2rad(10.0)
"""Joints that turn less than this, rms, do not show their axis."""
GAP = 5.0
"""Median intervals that integrated rates may have to bridge."""
UNLIKE = 0.3
"""Share of the rates, rms, that the orientations may fail to explain."""


class Axes(NamedTuple):
    """A joint's axes as its two sensors see them."""

    first: NDArray[np.float64]
    """(3,) unit vector in the first sensor's frame."""
    second: NDArray[np.float64]
    """(3,) unit vector in the second sensor's frame: of a hinge the same axis, of a two-axis joint the other one."""
    covariance: NDArray[np.float64]
    """(6, 6) of both, rad^2, along the sensors' axes."""
    heading: float
    """rad, the angle that turns the second IMU's earth frame into the first's, at the first sample."""
    drift: float
    """rad/s, by which it grows."""
    angle: float
    """rad between the two axes of a two-axis joint; 0 of a hinge."""
    residual: float
    """rad, rms of what the constraint leaves."""
    excursion: float
    """rad, rms of the rotation between the sensors about its mean."""

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of the two axes' directions, rad: the larger of each axis' two."""
        blocks = (self.covariance[:3, :3], self.covariance[3:, 3:])
        return tuple(float(np.sqrt(max(np.linalg.eigvalsh(b)[-1], 0))) for b in blocks)  # type: ignore[return-value]


def hinge(
    time: ArrayLike, first: ArrayLike, second: ArrayLike, *, rates: tuple[ArrayLike, ArrayLike] | None = None
) -> Axes:
    """Find the axis of a hinge between two IMUs.

    Args:
        time: (n,) s, increasing.
        first: (n, 4) wxyz, orientation of the IMU on one link, sensor to an upright frame.
        second: (n, 4) wxyz, of the one on the other link.
        rates: (n, 3) rad/s of each, what its gyroscope says; None if there are only the orientations.

    Returns:
        The axis in both frames, of one sign: `first = R_12 second`. Its own sign is arbitrary: the largest component of
        `first` is positive.

    Raises:
        InputError: shapes or stamps are wrong, values are not finite, the joint hardly turns, or the rates are
            not those of the orientations.
    """
    paths = _paths(time, first, second)
    j1, j2, heading = start_hinge(paths)
    found = refined(paths, j1, j2, heading, None)
    return _axes(paths, found, 0.0, _by_rates(time, first, second, rates, found))


def two_axis(
    time: ArrayLike, first: ArrayLike, second: ArrayLike, *, rates: tuple[ArrayLike, ArrayLike] | None = None
) -> Axes:
    """Find the axes of a joint with two of them: the first fixed to the first link, the second to the second.

    Args:
        time: (n,) s, increasing.
        first: (n, 4) wxyz, orientation of the IMU on one link, sensor to an upright frame.
        second: (n, 4) wxyz, of the one on the other link.
        rates: (n, 3) rad/s of each, what its gyroscope says; None if there are only the orientations.

    Returns:
        The axes; the sign of each is arbitrary: their largest components are positive. Calibrate the IMUs first: scales
        and axes of half a percent off made them .6 to 2.6 deg wrong in simulated motion of 20 s, and two of ten wrong
        altogether, which a `residual` of degrees gives away.

    Raises:
        InputError: shapes or stamps are wrong, values are not finite, the joint hardly turns, or the rates are
            not those of the orientations.
    """
    paths = _paths(time, first, second)
    best = min((fit_pair(paths, *start) for start in start_pair(paths)), key=lambda found: found.cost)
    return _axes(paths, best, float(best.angle or 0.0), _by_rates(time, first, second, rates, best))


def from_vectors(sensor: ArrayLike, link: ArrayLike, weight: ArrayLike | None = None) -> NDArray[np.float64]:
    """Return how a sensor sits on its link, from directions that are known in both: axes of joints, the vertical.

    Args:
        sensor: (k, 3) unit vectors in the sensor's frame.
        link: (k, 3) the same in the link's.
        weight: (k,) of each; all equal if None.

    Returns:
        (4,) wxyz, sensor to link.

    Raises:
        InputError: shapes are wrong, values are not finite, or the directions are all parallel.

    Source: Wahba 1965; Markley 1988 (singular value decomposition).
    """
    a, b = (np.asarray(x, np.float64) for x in (sensor, link))
    if a.shape != b.shape or a.ndim != 2 or a.shape[1:] != (3,):
        raise InputError(f"sensor, link: got shapes {a.shape} and {b.shape}, expected the same (k, 3)")
    w = np.ones(len(a)) if weight is None else np.asarray(weight, np.float64)
    if w.shape != (len(a),):
        raise InputError(f"weight: got shape {w.shape}, expected ({len(a)},), one a direction")
    for name, x in (("sensor", a), ("link", b), ("weight", w)):
        finite(name, x)
    u, size, vt = np.linalg.svd((w[:, None] * b).T @ a)
    if size[1] < 1e-3 * max(size[0], 1e-300):
        raise InputError("sensor: the directions are all parallel, expected two that are not; add another joint's axis")
    matrix = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return to_quaternion(matrix)


def zero_posture(
    force: ArrayLike, link: ArrayLike, nominal: ArrayLike = (1, 0, 0, 0), *, field: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Return how a sensor sits on its link, corrected by what it feels in a known posture (the paper's R_o).

    Without a magnetometer only the tilt can be corrected: the smallest correction to the nominal mounting that makes
    the vertical right. A rotation about the vertical of the zero posture stays as the nominal mounting has it.

    Args:
        force: (3,) mean specific force at rest in the posture, any unit, in the sensor's frame.
        link: (4,) wxyz, the link's orientation there, link to earth (ENU with a field).
        nominal: (4,) wxyz, the mounting as the robot's file says, sensor to link.
        field: (3,) mean magnetic field there, any unit, in the sensor's frame; None without a magnetometer.

    Returns:
        (4,) wxyz, sensor to link.

    Raises:
        InputError: a vector is zero or not finite, or the vertical is more than a quarter turn off.

    Source: Santaera 2015, eq. 25, with the frames of ERRATA S4.
    """
    carries, guess = (of_quaternions(np.asarray(q, np.float64)) for q in (link, nominal))
    felt = _direction("force", force)
    if field is not None:
        east = _direction("field", np.cross(_direction("field", field), felt))
        stands = np.stack([east, np.cross(felt, east), felt])  # rows: the earth's axes in the sensor
        return to_quaternion(carries.T @ stands)
    up, seen = carries.T @ np.array([0.0, 0, 1]), guess @ felt
    axis, cosine = np.cross(seen, up), float(seen @ up)
    if cosine < 0:
        raise InputError(
            f"mounting: the sensor's vertical is {np.rad2deg(np.arccos(max(cosine, -1))):.0f} deg from where the "
            "robot's file has it, expected less than 90; are axes swapped, or is another posture held?"
        )
    cross = skew(axis[None])[0]
    return to_quaternion((np.eye(3) + cross + cross @ cross / (1 + cosine)) @ guess)


def _direction(name: str, vector: ArrayLike) -> NDArray[np.float64]:
    v = np.asarray(vector, np.float64)
    size = float(np.linalg.norm(v)) if v.shape == (3,) else 0.0
    if not np.isfinite(size) or size == 0:
        raise InputError(f"{name}: got {vector!r}, expected (3,) finite and not zero")
    return v / size


def _paths(time: ArrayLike, first: ArrayLike, second: ArrayLike) -> Paths:
    t, a, b = (np.asarray(x, np.float64) for x in (time, first, second))
    if t.ndim != 1 or a.shape != (len(t), 4) or b.shape != (len(t), 4):
        raise InputError(f"time, first, second: got shapes {t.shape}, {a.shape}, {b.shape}, expected (n,) and (n, 4)")
    if len(t) < 10 or not (np.diff(t) > 0).all():
        raise InputError("time: expected at least ten increasing stamps")
    for name, q in (("first", a), ("second", b)):
        bad = ~np.isfinite(q).all(axis=1) | (np.linalg.norm(q, axis=1) < 0.5)
        if bad.any():
            raise InputError(f"{name}: row {int(np.argmax(bad))} is not a unit quaternion")
    thin = max(1, len(t) // 4000)
    return Paths.of(t[::thin], of_quaternions(a[::thin]), of_quaternions(b[::thin]))


def _by_rates(time: Any, first: Any, second: Any, rates: Any, found: Found) -> _axes_rates.Solved | None:
    """Refine what the orientations have found by the rates, if there are any."""
    if rates is None:
        return None
    t, given = np.asarray(time, np.float64), [np.asarray(r, np.float64) for r in rates]
    if len(given) != 2 or any(r.shape != (len(t), 3) for r in given):
        raise InputError(f"rates: got shapes {', '.join(str(r.shape) for r in given)}, expected two of ({len(t)}, 3)")
    rate = np.stack(given)
    if not np.isfinite(rate).all():
        at = int(np.argmin(np.isfinite(rate).all(axis=(0, 2))))
        raise InputError(f"rates: row {at} is not finite; leave out samples without a rate")
    gap = np.diff(t)
    if gap.max() > GAP * np.median(gap):
        where = f"time: a gap of {gap.max():.3g} s after {t[np.argmax(gap)]:.6g} s"
        raise InputError(f"{where}, rates cannot be integrated over it; use one side of it, or leave out rates")
    path = np.stack([of_quaternions(np.asarray(q, np.float64)) for q in (first, second)])
    heading = found.heading + found.drift * (t - t[0])
    turning, guess = _axes_rates.begun(t, rate, path, heading, (found.first, found.second, found.angle))
    for k, name in enumerate(("first", "second")):
        left = _axes_rates.unexplained(t, rate[k], path[k])
        if left > UNLIKE:
            raise InputError(
                f"rates: those of {name} are {left:.0%} off what its orientations do, expected at most {UNLIKE:.0%}; "
                "are they in rad/s, along the sensor's axes?"
            )
    return _axes_rates.solve(turning, guess)


def _axes(paths: Paths, found: Found, angle: float, exact: _axes_rates.Solved | None) -> Axes:
    rotation = paths.rotation(found.heading, found.drift)
    mean = rotation.mean(axis=0)
    excursion = float(np.sqrt(max(3 - np.sum(np.linalg.svd(mean)[1]), 0)))
    if excursion < LEAST:
        raise InputError(
            f"the joint turns by {np.rad2deg(excursion):.1f} deg rms, expected at least {np.rad2deg(LEAST):.0f}; "
            "move it more"
        )
    j1, j2, covariance, residual = found.first, found.second, found.covariance, found.residual
    if exact is not None:
        j1, j2, covariance, residual = exact.guess.first, exact.guess.second, exact.covariance, exact.residual
        angle = float(exact.guess.angle or 0.0)
    s1 = np.sign(j1[np.argmax(np.abs(j1))])
    s2 = s1 if angle == 0.0 else np.sign(j2[np.argmax(np.abs(j2))])
    if s1 * s2 < 0:
        angle = np.pi - angle
    sign = np.diag([s1] * 3 + [s2] * 3)
    covariance = sign @ covariance @ sign
    return Axes(s1 * j1, s2 * j2, covariance, found.heading, found.drift, angle, residual, excursion)


__all__ = ["LEAST", "Axes", "from_vectors", "hinge", "two_axis", "zero_posture"]
