"""From two IMUs' own recordings to `Pair`s at common times, and what is wrong with them; on the host, in float64.

`pair` brings P's readings to A's stamps, `estimate` checks them and solves for the pose, `explain` says which component
a covariance leaves open.
"""

import math
from typing import Any, Literal, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from jaxest.calibration import clock
from jaxest.manifolds import quaternion as quat
from jaxest.systems import onsite_batch
from jaxest.systems._onsite_imu import Imu, at_limit, brought, clipped, resampled
from jaxest.systems.onsite_simulation import Pair
from jaxest.types import InputError, Reading

MOST_CLIPPED = 0.1  # share of clipped samples above which the rest says too little of the quick motion
LOOSE = {"rates": 0.15, "forces": 0.3}  # what is left over their size, above which no link is rigid; forces have biases
NOISY = 4.0  # likewise over their noise
SHARP = (math.radians(5.0), 0.02)  # standard deviations, rad and m, above which a component counts as open
DRIFT = 0.005  # s over the recording above which two clocks must not be taken for one


class Found(NamedTuple):
    """What a recording of two IMUs says."""

    estimate: onsite_batch.Estimate
    half_width: int
    """N of the window."""
    offset: clock.Offset | None
    """Of P's clock against A's, taken off P's stamps; None where they could not be compared."""
    time: NDArray[np.float64]
    """(T,) s, the common times."""
    measurements: Pair
    notes: tuple[str, ...]
    """What was found and done, a sentence each."""


def pair(a: Imu, p: Imu, *, offset: float = 0.0) -> tuple[NDArray[np.float64], Pair]:
    """Bring P's readings to A's stamps.

    Args:
        a: the IMU whose clock and frame are kept.
        p: the other.
        offset: s, what P's clock shows more than A's.

    Returns:
        Times (T,) and measurements with a leading axis of T: A's samples within P's recording, those within a gap of
        P's or at a sensor's limit invalid.

    Raises:
        InputError: the recordings do not overlap, or stamps are wrong.

    Source: Sato 2024, section III-C and Fig. 3.
    """
    stamps = np.asarray(p.time, np.float64) - offset
    rows = np.flatnonzero((a.time >= stamps[0]) & (a.time <= stamps[-1]))
    if len(rows) < 2:
        raise InputError(
            f"the recordings do not overlap: one from {a.time[0]:.3f} to {a.time[-1]:.3f} s, the other from "
            f"{stamps[0]:.3f} to {stamps[-1]:.3f} s"
        )
    time = np.asarray(a.time, np.float64)[rows]
    value, there = brought(p._replace(time=stamps), time)
    here = ~at_limit(a)[rows]
    dt = np.diff(time, prepend=time[0])
    own = [_reading(np.asarray(x, np.float64)[rows], here[:, k]) for k, x in enumerate((a.gyroscope, a.accelerometer))]
    other = [_reading(value[:, s], there[:, k]) for k, s in enumerate((slice(0, 3), slice(3, 6)))]
    (rates, forces), (others, felt) = own, other
    return time, Pair(rates, forces, others, felt, dt)


def _reading(value: Any, valid: Any) -> Reading:
    return Reading(value, valid)


def estimate(
    a: Imu, p: Imu, *, prior: onsite_batch.Prior | None = None, names: tuple[str, str] = ("a", "p"),
    align_clocks: bool = True,
) -> Found:  # fmt: skip
    """Check two recordings and find the pose of IMU P in A.

    Args:
        a: the IMU whose frame the pose is in.
        p: the other.
        prior: of the biases, as for `onsite_batch.choose`.
        names: of the two, for messages.
        align_clocks: whether to look for an offset of the clocks, and take it off where it is certain.

    Returns:
        The estimate.

    Raises:
        InputError: too few samples, saturated sensors, clocks that drift, IMUs that are not on one rigid link, or too
            little rotation; which sensor, axis or component is named.
    """
    offset, late, notes = checked(a, p, names, align_clocks=align_clocks)
    time, measurements = pair(a, p, offset=late)
    choice = onsite_batch.choose(measurements, prior)
    found = choice.estimate
    if offset:
        # What was not taken off may be there all the same.
        error = math.hypot(offset.deviation, offset.seconds - late)
        late_too = found.covariance + late_by(p, late, error, time, measurements, choice, prior)
        found = found._replace(covariance=late_too)
    one, other = (np.asarray(x.value, np.float64) for x in (measurements.gyroscope_a, measurements.gyroscope_p))
    refuse_loose(names, "rates", one, other, float(found.rate_residual))
    why = explain(np.asarray(found.covariance, np.float64))
    if why:
        raise InputError(f"the pose of {names[1]} in {names[0]} is not determined: {why}")
    return Found(found, int(choice.half_width), offset, time, measurements, notes)


def checked(
    a: Imu, p: Imu, names: tuple[str, str], *, align_clocks: bool = True
) -> tuple[clock.Offset | None, float, tuple[str, ...]]:
    """Check two recordings for saturated sensors and for clocks that do not agree.

    Args:
        a: one IMU.
        p: the other on its link.
        names: of the two, for messages.
        align_clocks: whether to look for an offset of the clocks.

    Returns:
        The offset, None where it was not looked for or the motion does not tell; what of it is certain, s, to be taken
        off P's stamps; and what was found, a sentence each.

    Raises:
        InputError: a sensor is saturated too often, or the clocks drift.
    """
    notes = [note for name, imu in zip(names, (a, p), strict=True) for note in _clipped(name, imu)]
    offset = _clocks(a, p, names) if align_clocks else None
    late = offset.seconds if offset and abs(offset.seconds) > 5 * offset.deviation else 0.0
    if late:
        notes.append(f"{names[1]}'s clock shows {1e3 * late:+.2f} ms against {names[0]}'s: taken off")
    return offset, late, tuple(notes)


def late_by(
    p: Imu, offset: float, error: float, time: NDArray[np.float64], measurements: Pair, choice: onsite_batch.Choice,
    prior: onsite_batch.Prior | None,
) -> NDArray[np.float64]:  # fmt: skip
    """Return what an error of the clocks' offset adds to the covariance of the pose, (6, 6) as that of `estimate`.

    Args:
        p: the IMU whose clock it is.
        offset: s, what was taken off its stamps.
        error: s, standard deviation of what is left.
        time: (T,) s, the common times.
        measurements: at these times.
        choice: the estimate from them.
        prior: as for `onsite_batch.choose`.

    Returns:
        The square of the shift that one standard deviation causes.
    """
    value, there = brought(p._replace(time=np.asarray(p.time, np.float64) - offset - error), time)
    there = there.all(axis=1) & np.asarray(measurements.gyroscope_p.valid & measurements.accelerometer_p.valid)
    rates, forces = _reading(value[:, :3], there), _reading(value[:, 3:], there)
    every = onsite_batch.choose(measurements._replace(gyroscope_p=rates, accelerometer_p=forces), prior).all
    formal = np.asarray(choice.all.formal)
    best = int(np.argmin(np.where(np.isfinite(formal), formal, np.inf)))
    one, other = (jax.tree.map(lambda x: x[best], x) for x in (choice.all, every))
    turn = jax.device_get(quat.local(one.quaternion, other.quaternion))
    shift = np.concatenate([turn, np.asarray(other.position) - np.asarray(one.position)]).astype(np.float64)
    return np.outer(shift, shift)


def _clocks(a: Imu, p: Imu, names: tuple[str, str]) -> clock.Offset | None:
    """Compare the clocks; None where the motion does not tell."""
    half = min(0.5, (min(a.time[-1], p.time[-1]) - max(a.time[0], p.time[0])) / 8)
    try:
        found = clock.offset(a.time, a.gyroscope, p.time, p.gyroscope, most=half)
    except InputError:
        return None
    apart = abs(found.drift) * (a.time[-1] - a.time[0])
    if apart > DRIFT and abs(found.drift) > 5 * found.drift_deviation:
        raise InputError(
            f"the clocks of {names[0]} and {names[1]} drift apart by {1e3 * found.drift:+.3f} ms/s, "
            f"{1e3 * apart:.1f} ms over the recording; expected less than {1e3 * DRIFT:g} ms: synchronise them"
        )
    return found


def _clipped(name: str, imu: Imu) -> list[str]:
    notes = []
    shares = np.mean(at_limit(imu), axis=0)
    for kind, value, share in zip(("gyroscope", "accelerometer"), imu[1:3], shares, strict=True):
        if share > MOST_CLIPPED:
            raise InputError(
                f"{name}/{kind}: saturated in {100 * share:.0f} % of the samples, at {np.abs(value).max():.4g}; "
                f"expected at most {100 * MOST_CLIPPED:.0f} %: shake less or choose a wider range"
            )
        if share:
            notes.append(f"{name}/{kind}: saturated in {100 * share:.1f} % of the samples, which are left out")
    return notes


def noise(values: NDArray[np.float64]) -> float:
    """Return the standard deviation of readings' white noise, (n, 3), whatever the smooth motion below it.

    An n-th difference takes a motion away in proportion to (2 pi f / rate)^n and leaves white noise times the root of
    binomial(2 n, n); the smallest figure of several n counts.
    """
    orders = range(2, 7)
    return float(min(np.sqrt(np.mean(np.diff(values, n, axis=0) ** 2) / math.comb(2 * n, n)) for n in orders))


def refuse_loose(
    names: tuple[str, str], what: Literal["rates", "forces"], a: NDArray[np.float64], p: NDArray[np.float64],
    left: float,
) -> None:  # fmt: skip
    """Refuse two IMUs that cannot be on one rigid link.

    On one link the rates agree once turned, and the forces once brought to one place as well. What is left of their
    difference is compared with the sensors' noise, and with the motion: scale errors of sensors that nobody calibrated
    leave a few per cent.

    Args:
        names: of the two, for messages.
        what: is compared.
        a: (n, 3) rad/s or m/s2, of one.
        p: (m, 3), of the other.
        left: rad/s or m/s2, standard deviation about an axis of what is left of their difference.

    Raises:
        InputError: it is too much.
    """
    rest = a.mean(axis=0) if what == "rates" else 0.0  # errors of scale are of gravity, too
    size, level = float(np.sqrt(np.mean((a - rest) ** 2))), math.hypot(noise(a), noise(p))
    if left > LOOSE[what] * size and left > NOISY * level:
        unit, wrong = ("rad/s", "") if what == "rates" else ("m/s2", ", or a sensor's axis points the wrong way")
        raise InputError(
            f"{names[0]} and {names[1]} are not on one rigid link{wrong}: their {what} differ by {left:.3g} {unit} rms "
            f"about an axis once turned, {left / level:.0f} times their noise and {100 * left / size:.0f} % of "
            f"their size; expected at most {NOISY:g} times or {100 * LOOSE[what]:.0f} %"
        )


def explain(covariance: NDArray[np.float64]) -> str:
    """Say which component of a pose a covariance leaves open, and what to do; nothing where all are known.

    Args:
        covariance: (6, 6) rotation vector in P, on the right, and position in A.

    Returns:
        A sentence, or nothing.
    """
    if not np.isfinite(covariance).all():
        return "its covariance is not finite"
    parts = []
    for what, half, most, scale, unit in (
        ("the rotation about", slice(0, 3), SHARP[0], math.degrees(1), "deg"),
        ("the position along", slice(3, 6), SHARP[1], 1e3, "mm"),
    ):
        values, vectors = np.linalg.eigh(covariance[half, half])
        for value, axis in zip(values, vectors.T, strict=True):
            size = math.sqrt(max(value, 0.0))
            if size > most:
                axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
                way = ", ".join(f"{x:.2f}" for x in axis + 0.0)
                frame = "P" if unit == "deg" else "A"
                known = f"known to {scale * size:.3g} {unit} only" if size < 10 * most else "open"
                parts.append(f"{what} [{way}] of {frame} is {known}")
    return f"{'; '.join(parts)}; turn the link about another axis, and harder" if parts else ""


def rotation_error(one: Any, other: Any) -> float:
    """Return the angle between two quaternions, rad."""
    return float(np.linalg.norm(np.asarray(jax.device_get(quat.local(one, other)), np.float64)))


__all__ = [
    "Found",
    "Imu",
    "brought",
    "checked",
    "clipped",
    "estimate",
    "explain",
    "late_by",
    "noise",
    "pair",
    "refuse_loose",
    "resampled",
    "rotation_error",
]
