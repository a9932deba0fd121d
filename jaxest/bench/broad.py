"""How accurate the attitude filters are on the recordings of BROAD (Laidig et al. 2021), beside others'.

All trials at once, padded to one length and masked, each filter with one setting for all. A figure is the mean over the
trials of a group of the root mean square error over the samples that move and whose truth is known, in degrees.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxest.bench import attitude_peers
from jaxest.bench.harness import Progress, find_peer
from jaxest.filters import attitude, complementary, run
from jaxest.filters.imu import Imu
from jaxest.io import read
from jaxest.io.report import Row
from jaxest.metrics import broad_rmse_deg
from jaxest.types import InputError, Reading

ONLINE = {
    "ekf": attitude.ekf,
    "decoupled": attitude.decoupled,
    "madgwick": attitude.madgwick,
    "complementary": complementary,  # whose default gains are 0.74 and 0.0012
}
"""Filters that run sample by sample."""
SMOOTHER = "ekf, smoothed"
PEERS = {SMOOTHER: "offline VQF"}
GROUPS = {
    "undisturbed, rotation": ("undisturbed", "rotation"),
    "undisturbed, translation": ("undisturbed", "translation"),
    "undisturbed, combined": ("undisturbed", "combined"),
    "undisturbed, slow": ("undisturbed", "slow"),
    "undisturbed, fast": ("undisturbed", "fast"),
    "with breaks": ("breaks",),
    "tapping": ("tapping",),
    "vibration": ("vibration",),
    "stationary magnet": ("stationary", "magnet"),
    "attached magnet": ("attached", "magnet"),
    "office": ("office",),
    "mixed": ("mixed",),
}
"""Name of a group, and the words of a trial's file name that put it there."""
BIAS = np.deg2rad([0.5, -0.5, 0.5])
"""rad/s, added to the gyroscope of every trial in the group of that name; what is in the recordings is hardly any."""
BIASED = "all, a gyro bias of 0.87 deg/s added"
BLOCK = 0.03  # s between corrections of the smoother


class Trial(NamedTuple):
    """One recording."""

    name: str
    sensors: dict[str, NDArray[np.float64]]
    """(T, 3) each"""
    interval: float
    """s"""
    truth: NDArray[np.float64]
    """(T, 4) wxyz, NaN where unknown"""
    movement: NDArray[np.bool_]
    """(T,)"""


def files(folder: Path) -> list[Path]:
    """Return the files of a folder's trials, by name; raises InputError where there is none."""
    found = sorted(folder.glob("*.npz"))
    if not found:
        raise InputError(f"{folder}: no NPZ file, expected the trials of BROAD")
    return found


def load(folder: Path) -> list[Trial]:
    """Read the trials of a folder.

    Args:
        folder: with the trials as NPZ, in the layout of the benchmark's authors or ours.

    Returns:
        The trials, by name.

    Raises:
        InputError: there is none, or one has no truth.
    """
    return [_trial(file) for file in files(folder)]


def _trial(file: Path) -> Trial:
    streams = read(file).streams
    wanted = ("gyroscope", "accelerometer", "magnetometer", "orientation", "movement")
    missing = [name for name in wanted if name not in streams]
    if missing:
        raise InputError(f"{file}: no stream {missing[0]!r}, expected {', '.join(wanted)}")
    values = {name: np.asarray(streams[name].value, np.float64) for name in wanted}
    interval = float(np.median(np.diff(streams["gyroscope"].time)))
    movement = values["movement"].reshape(-1) > 0
    return Trial(file.stem, {name: values[name] for name in wanted[:3]}, interval, values["orientation"], movement)


def padded(trials: list[Trial], axes: int, dtype: Any = np.float32) -> Imu:
    """Put trials into one batch.

    Args:
        trials: any number.
        axes: 6 or 9.
        dtype: of the readings.

    Returns:
        Measurements (trials, longest, ...); behind the end of a trial nothing is valid and no time passes.
    """
    longest = max(len(trial.movement) for trial in trials)

    def fill(rows: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate([rows, np.zeros((longest - len(rows), *rows.shape[1:]), rows.dtype)])

    there = np.stack([fill(np.ones(len(trial.movement), bool)) for trial in trials])
    dt = np.where(there, np.array([[trial.interval] for trial in trials]), 0).astype(dtype)
    names = ("gyroscope", "accelerometer", "magnetometer")
    values = [np.stack([fill(trial.sensors[name]) for trial in trials]).astype(dtype) for name in names]
    gyr, acc, mag = (Reading(*(jnp.asarray(x) for x in (value, there))) for value in values)
    return Imu(gyr, acc, mag if axes == 9 else None, dt)


def estimates(name: str, trials: list[Trial], axes: int, dtype: Any = np.float32) -> list[NDArray[Any]]:
    """Run one filter over all trials.

    Args:
        name: of `ONLINE`, or `SMOOTHER`.
        trials: any number.
        axes: 6 or 9.
        dtype: precision; float64 needs `JAX_ENABLE_X64`.

    Returns:
        (T, 4) wxyz a trial.
    """
    measurements = padded(trials, axes, dtype)
    if name == SMOOTHER:
        found: Any = _smoothed(measurements, trials, dtype)
    else:
        module: Any = ONLINE[name]
        params = jax.tree.map(dtype, module.Params())

        def quaternion(state: Any, info: Any) -> Any:
            return info.quaternion

        def one(measurements: Imu) -> Any:
            return run(module.step, params, module.init(params), measurements, history=quaternion)[1]

        found = np.asarray(jax.jit(jax.vmap(one))(measurements))
    return [np.asarray(q, np.float64)[: len(trial.movement)] for q, trial in zip(found, trials, strict=True)]


def _smoothed(measurements: Imu, trials: list[Trial], dtype: Any) -> list[Any]:
    """One trial after the other, for the memory's sake."""
    params = jax.tree.map(dtype, attitude.ekf.Params())
    state0 = attitude.ekf.init(params)
    found = []
    for i, trial in enumerate(trials):
        rows = jax.tree.map(lambda x, i=i: x[i], measurements)
        block = max(1, round(BLOCK / trial.interval))
        found.append(np.asarray(attitude.smooth(params, state0, rows, block=block).quaternion))
    return found


def peer(vqf: Any, name: str, trials: list[Trial], axes: int) -> list[NDArray[Any]]:
    """Run VQF, `"VQF"` or `"offline VQF"`, over all trials; (T, 4) a trial."""
    found = []
    for trial in trials:
        readings = [np.ascontiguousarray(x) for x in trial.sensors.values()]
        offline = name == "offline VQF"
        out = vqf.offlineVQF(*readings, trial.interval) if offline else vqf.VQF(trial.interval).updateBatch(*readings)
        found.append(out[f"quat{axes}D"])
    return found


def rows(folder: Path, *, peers: bool = True, progress: Progress = lambda message: None) -> Iterable[Row]:
    """Measure every filter on every group of trials.

    Args:
        folder: with the trials.
        peers: whether to run VQF beside them, and `imufusion` and `ahrs` where they are installed.
        progress: hears what is being measured.

    Yields:
        Inclination errors with 6 axes and total errors with 9, with VQF's of the same kind as reference; `ratio` is how
        many times smaller ours is.

    Raises:
        InputError: as `load`.
    """
    trials = load(folder)
    members = groups(trials)
    turned = [t._replace(sensors={**t.sensors, "gyroscope": t.sensors["gyroscope"] + BIAS}) for t in trials]
    vqf = find_peer("vqf") if peers else None
    for axes, part in ((6, "inclination"), (9, "total")):
        for name in (*ONLINE, SMOOTHER):
            for recorded, chosen in ((trials, members), (turned, {BIASED: list(range(len(trials)))})):
                if recorded is turned and name not in ("ekf", SMOOTHER):
                    continue
                progress(f"{name}, {axes} axes{', with a gyro bias' if recorded is turned else ''}")
                error = _errors(recorded, estimates(name, recorded, axes), part)
                reference = PEERS.get(name, "VQF")
                beside = None if vqf is None else _errors(recorded, peer(vqf, reference, recorded, axes), part)
                yield from _rows(f"{part} RMSE, {axes} axes, {name}", chosen, error, reference, beside)
        for name, quaternions in _others(trials, axes, progress).items() if peers else ():
            yield from _rows(f"{part} RMSE, {axes} axes, {name}", members, _errors(trials, quaternions, part), "", None)


def _others(trials: list[Trial], axes: int, progress: Progress) -> dict[str, list[NDArray[Any]]]:
    """Estimates of all trials by the filters of `attitude_peers`, by name."""
    found: dict[str, list[NDArray[Any]]] = {}
    for trial in trials:
        progress(f"imufusion, ahrs, {axes} axes: {trial.name}")
        for name, quaternions in attitude_peers.estimates(trial.sensors, trial.interval, axes).items():
            found.setdefault(name, []).append(quaternions)
    return found


def _rows(
    metric: str, members: dict[str, list[int]], error: NDArray[np.float64], reference: str, beside: Any
) -> Iterable[Row]:  # fmt: skip
    for group, chosen in members.items():
        ours = float(error[chosen].mean())
        theirs = None if beside is None else float(beside[chosen].mean())
        ratio, named = (None, None) if theirs is None else (theirs / ours, reference)
        yield Row(metric, group, ours, "deg", None, len(chosen), theirs, named, ratio)


def groups(trials: list[Trial]) -> dict[str, list[int]]:
    """Return the indices of the trials of each group that has any; the first is all."""
    found = {"all": list(range(len(trials)))}
    for group, words in GROUPS.items():
        chosen = [i for i, trial in enumerate(trials) if set(words) <= set(trial.name.split("_"))]
        if chosen:
            found[group] = chosen
    return found


def _errors(trials: list[Trial], quaternions: list[NDArray[Any]], part: str) -> NDArray[np.float64]:
    found = [
        getattr(broad_rmse_deg(q, trial.truth, trial.movement), part)
        for q, trial in zip(quaternions, trials, strict=True)
    ]
    return np.asarray(found, np.float64)


def table(measured: Iterable[Row]) -> str:
    """Return the rows as text: a line a group, a column a filter and VQF's beside it."""
    cells: dict[tuple[str, str], Row] = {(row.condition, row.metric): row for row in measured}
    conditions, metrics = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    lines = []
    for metric in metrics:
        lines += ["", metric]
        for row in (cells[condition, metric] for condition in conditions if (condition, metric) in cells):
            beside = "" if row.reference is None else f"   {row.reference_name} {row.reference:6.2f}"
            lines.append(f"  {row.condition:40s} {row.n:3d} trials  {row.value:6.2f}{beside}")
    return "\n".join(lines)


__all__ = [
    "GROUPS",
    "ONLINE",
    "SMOOTHER",
    "Trial",
    "estimates",
    "files",
    "groups",
    "load",
    "padded",
    "peer",
    "rows",
    "table",
]
