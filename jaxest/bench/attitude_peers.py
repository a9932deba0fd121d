"""Other people's attitude filters from Python, sample by sample, each with its own defaults: `imufusion` and `ahrs`."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.bench.harness import find_peer

G, MICRO, NANO = 9.80665, 1e6, 1e9
PEERS = {"imufusion": "imufusion", "ahrs, Madgwick": "ahrs", "ahrs, Mahony": "ahrs"}
"""Name of a filter, and the package that it needs."""
Step = Callable[[NDArray[Any], NDArray[Any], NDArray[Any]], Any]
"""Takes a sample of gyroscope (3,) rad/s, accelerometer (3,) m/s2 and magnetometer (3,) T; returns the quaternion."""


def steps(interval: float, axes: int) -> dict[str, Step]:
    """Return a step of each filter that is installed, at rest before its first sample.

    Args:
        interval: s between samples.
        axes: 6 or 9.

    Returns:
        Steps by name; what they return is wxyz, sensor to earth.
    """
    found: dict[str, Step] = {}
    fusion, ahrs = find_peer("imufusion"), find_peer("ahrs")
    if fusion is not None:
        found["imufusion"] = _fusion(fusion, interval, axes)
    if ahrs is not None:
        found["ahrs, Madgwick"] = _ahrs(ahrs.filters.Madgwick, interval, axes)
        found["ahrs, Mahony"] = _ahrs(ahrs.filters.Mahony, interval, axes)
    return found


def _fusion(fusion: Any, interval: float, axes: int) -> Step:
    settings, filtering = fusion.AhrsSettings(), fusion.Ahrs()
    settings.convention, settings.sample_rate = fusion.CONVENTION_ENU, 1 / interval
    filtering.set_settings(settings)

    def step(gyr: NDArray[Any], acc: NDArray[Any], mag: NDArray[Any]) -> Any:
        if axes == 9:
            filtering.update(np.rad2deg(gyr), acc / G, mag * MICRO)
        else:
            filtering.update_no_magnetometer(np.rad2deg(gyr), acc / G)
        return filtering.get_quaternion()

    return step


def _ahrs(kind: Any, interval: float, axes: int) -> Step:
    filtering, held = kind(Dt=interval), {"q": np.zeros(4)}

    def step(gyr: NDArray[Any], acc: NDArray[Any], mag: NDArray[Any]) -> Any:
        if not held["q"].any():  # where it would begin a recording
            twice = {"gyr": np.stack([gyr] * 2), "acc": np.stack([acc] * 2)}
            held["q"] = kind(**twice, Dt=interval, **({"mag": np.stack([mag * NANO] * 2)} if axes == 9 else {})).Q[0]
        if axes == 9:
            held["q"] = filtering.updateMARG(held["q"], gyr=gyr, acc=acc, mag=mag * NANO)
        else:
            held["q"] = filtering.updateIMU(held["q"], gyr=gyr, acc=acc)
        return held["q"]

    return step


def estimates(sensors: Mapping[str, NDArray[Any]], interval: float, axes: int) -> dict[str, NDArray[np.float64]]:
    """Run every filter over one recording.

    Args:
        sensors: `gyroscope` rad/s, `accelerometer` m/s2, `magnetometer` T, (T, 3) each.
        interval: s.
        axes: 6 or 9.

    Returns:
        (T, 4) wxyz by name, in ENU; Madgwick's, whose x axis points north, are turned by a quarter.
    """
    found = {}
    rows = list(zip(*(np.asarray(sensors[k]) for k in ("gyroscope", "accelerometer", "magnetometer")), strict=True))
    for name, step in steps(interval, axes).items():
        q = np.array([np.array(step(*row), float) for row in rows])
        if name == "ahrs, Madgwick" and axes == 9:
            w, x, y, z = np.sqrt(0.5) * q.T
            q = np.stack([w - z, x - y, y + x, z + w], axis=1)
        found[name] = q
    return found


__all__ = ["PEERS", "estimates", "steps"]
