"""Savitzky-Golay on a recording: on even stamps beside SciPy, on real ones beside NumPy's least squares."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.bench.harness import Candidate, Progress, compare, find_peer, race
from jaxest.filters import savitzky_golay
from jaxest.io.report import Row

HALF, DEGREE, RATE = 7, 3, 200.0


def rows(*, peers: bool, progress: Progress, small: bool = False) -> Iterable[Row]:
    """Time value and derivative at every sample of three channels in float32, windows of 15 samples, degree 3.

    SciPy's filter is a convolution, for samples evenly spaced only; ours fits every window for itself.

    Args:
        peers: whether to run SciPy, and a loop over windows with `numpy.linalg.lstsq`.
        progress: hears what is being measured.
        small: a short recording.

    Yields:
        Times per sample, and the largest difference to each peer's values.
    """
    progress("savitzky_golay")
    count = 60 if small else 20_000
    rng = np.random.default_rng(0)
    value = np.cumsum(rng.normal(size=(count, 3)), axis=0).astype(np.float32)
    even = np.arange(count) / RATE
    real = np.sort(even + rng.uniform(0, 0.8 / RATE, count))
    candidates = [
        Candidate("even", lambda: savitzky_golay.smooth(even, value, half_width=HALF, degree=DEGREE), count),
        Candidate("real", lambda: savitzky_golay.smooth(real, value, half_width=HALF, degree=DEGREE), count),
    ]
    signal = find_peer("scipy.signal") if peers else None
    names = {"even": "SciPy, savgol_filter, float32", "real": "NumPy, lstsq in a loop over windows"}
    if signal is not None:
        candidates.append(Candidate(names["even"], lambda: _scipy(signal, value), count))
    if peers:
        few = min(count, 1000)
        candidates.append(Candidate(names["real"], lambda: _loop(real[:few], value[:few]), few - 2 * HALF))
    found = race(candidates, repeats=2 if small else 10)
    for stamps in ("even", "real"):
        condition = f"{count} samples of 3 channels, {stamps} stamps, value and derivative, per sample"
        missing = "scipy" if peers and names[stamps] not in found else ""
        yield compare("batched step", condition, found[stamps], found.get(names[stamps]), unit="ns", missing=missing)
    if signal is not None:
        yield _difference(names["even"], even, value, _scipy(signal, value)[0][HALF:-HALF])
    if peers:
        few = 6 * HALF
        yield _difference(names["real"], real, value, _loop(real[:few], value[:few])[0])


def _difference(name: str, time: NDArray[Any], value: NDArray[Any], theirs: NDArray[Any]) -> Row:
    """Compare with a peer's values from the first whole window on."""
    ours = np.asarray(savitzky_golay.smooth(time, value, half_width=HALF, degree=DEGREE).value)
    off = np.abs(ours[HALF : HALF + len(theirs)] - theirs).max()
    return Row("largest difference of a value", name, float(off), "1")


def _scipy(signal: Any, value: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    width, step = 2 * HALF + 1, 1 / RATE
    return (
        signal.savgol_filter(value, width, DEGREE, axis=0),
        signal.savgol_filter(value, width, DEGREE, deriv=1, delta=step, axis=0),
    )


def _loop(time: NDArray[Any], value: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values and derivatives at the samples that have a whole window."""
    fits = []
    for i in range(HALF, len(time) - HALF):
        part = slice(i - HALF, i + HALF + 1)
        powers = np.vander(time[part] - time[i], DEGREE + 1, increasing=True)
        fits.append(np.linalg.lstsq(powers, value[part], rcond=None)[0][:2])
    both = np.array(fits)
    return both[:, 0], both[:, 1]
