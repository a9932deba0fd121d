"""What ranging sensors on a moving robot read in a scene: MuJoCo casts the rays, on the host.

`inside(model, seed, ...)` draws a motion that touches nothing (`crawl` one that lies on the floor), `cast` what the
sensors would read without faults, which may be kept (`save`, `load`), and `corrupt` adds the faults of real parts.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jaxest.files import kept, replacing
from jaxest.sensors.proximity import Proximity
from jaxest.types import InputError, unknown_name

if TYPE_CHECKING:
    import mujoco

SIGMAS = 2.7
"""Standard deviations in `alpha r`. Source: Iwao 2025, section III."""


class Scan(NamedTuple):
    """Ranges without faults, and the motion they belong to."""

    time: NDArray[np.float64]
    """(T,) s."""
    q: NDArray[np.float64]
    """(T, nq) the true configuration."""
    ranges: NDArray[np.float32]
    """(T, R) m, zone after zone of sensor after sensor; infinite where nothing is met."""


class Faults(NamedTuple):
    """How bad the sensors are."""

    noise: float = 0.01
    """Alpha: a range is off by alpha r at 2.7 standard deviations."""
    bias: ArrayLike = 0.05
    """() or (n,) rad or m, encoder reading less the joint's coordinate."""
    encoder: float = 0.0
    """rad or m, white noise of an encoder."""
    dropout: float = 0.0
    """Share of the zones that say nothing, at random."""


def compiled(source: Any) -> mujoco.MjModel:
    """Return MuJoCo's model of MJCF text or of a file, with what is missing in it left out."""
    from jaxest.kinematics.load import compile_model

    return source if hasattr(source, "jnt_qposadr") else compile_model(source)


def inside(
    source: Any, seed: int, *, duration: float = 60.0, dt: float = 0.1, amplitude: float = 0.35, hertz: float = 0.1,
    tries: int = 200,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Draw a motion of the hinges that touches nothing at any second sample, which is what is tried.

    Args:
        source: scene, MJCF text, file or model.
        seed: of the motion.
        duration: s.
        dt: s.
        amplitude: rad, of the largest sine wave; it shrinks as tries fail.
        hertz: of the fastest one.
        tries: motions drawn before giving up.

    Returns:
        Time (T,) s and q (T, nq): each hinge a sine wave about an offset of its own, within its limits.

    Raises:
        InputError: every try touched something.
    """
    import mujoco

    model = compiled(source)
    data = mujoco.MjData(model)
    time: Any = np.arange(round(duration / dt)) * dt
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    at = model.jnt_qposadr[hinges]
    for attempt in range(tries):
        random = np.random.default_rng([seed, attempt, 7002])
        size = amplitude * 0.98**attempt
        n = len(hinges)
        swing = size * random.uniform(0.2, 1, n)
        rate = hertz * random.uniform(0.3, 1, n)
        offset = 0.6 * size * random.uniform(-1, 1, n)
        wave = offset + swing * np.sin(2 * np.pi * (rate * time[:, None] + random.uniform(0, 1, n)))
        q: Any = np.tile(model.qpos0, (len(time), 1))
        q[:, at] += wave
        limited = model.jnt_limited[hinges].astype(bool)
        low, high = model.jnt_range[hinges].T
        q[:, at[limited]] = np.clip(q[:, at[limited]], low[limited], high[limited])
        if not touches(model, data, q):
            return time, q
    raise InputError(f"motion: {tries} motions of up to {amplitude:g} rad all touched something in the scene")


def touches(model: mujoco.MjModel, data: mujoco.MjData, q: NDArray[np.float64], every: int = 2) -> bool:
    """Tell whether a motion (T, nq) meets anything that can collide with it, at every `every`-th sample."""
    import mujoco

    for row in q[::every]:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return True
    return False


def crawl(
    source: Any, seed: int, *, duration: float = 60.0, dt: float = 0.1, amplitude: float = 0.25, hertz: float = 0.1,
    start: float = 10.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Let a free structure with position servos move on the floor, with contact.

    Args:
        source: scene with a free root and a servo for each hinge.
        seed: of the commands.
        duration: s.
        dt: s.
        amplitude: rad, of the largest command.
        hertz: of the fastest one.
        start: s, until the commands have grown to their size.

    Returns:
        Time (T,) s and q (T, nq), which begins where the structure came to rest, near the home of its root.
    """
    import mujoco

    model = compiled(source)
    data = mujoco.MjData(model)
    random = np.random.default_rng([seed, 7003])
    n = model.nu
    level = np.abs(model.jnt_axis[model.actuator_trnid[:, 0], 2]) > 0.5
    swing = amplitude * random.uniform(0.3, 1, n) * np.where(level, 1, 0.35)
    rate, phase = hertz * random.uniform(0.3, 1, n), random.uniform(0, 2 * np.pi, n)
    steps = round(dt / model.opt.timestep)
    for _ in range(round(1.5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    rows: list[Any] = []
    time: Any = np.arange(round(duration / dt)) * dt
    for t in time:
        rows.append(data.qpos.copy())
        for k in range(steps):
            now = t + k * model.opt.timestep
            data.ctrl[:] = min(now / start, 1.0) * swing * np.sin(2 * np.pi * rate * now + phase)
            mujoco.mj_step(model, data)
    return time, np.array(rows)


def cast(
    source: Any,
    sensors: Sequence[Proximity],
    q: NDArray[np.float64],
    time: NDArray[np.float64],
    *,
    stagger: ArrayLike = 0.0,
    itself: bool = False,
) -> Scan:
    """Cast every sensor's rays at every sample.

    Args:
        source: scene, MJCF text, file or model.
        sensors: S sensors.
        q: (T, nq).
        time: (T,) s, increasing.
        stagger: () or (S,) s, how much earlier than the sample a sensor measures.
        itself: whether rays meet the robot's own links.

    Returns:
        The scan.

    Raises:
        InputError: a frame does not exist, times are out of order, or q has not a row for each.
    """
    import mujoco

    model = compiled(source)
    if np.shape(q) != (len(time), model.nq):
        raise InputError(f"q: got shape {np.shape(q)}, expected {(len(time), model.nq)}, a row for each time")
    if np.any(np.diff(time) <= 0):
        raise InputError(f"time: row {int(np.argmax(np.diff(time) <= 0)) + 1} is not later than the row before")
    placed = [_placed(model, one.frame) for one in sensors]
    if not itself:
        model = _unseen(model, {int(model.body_rootid[body]) for body, _ in placed})
    data = mujoco.MjData(model)
    late = np.broadcast_to(np.asarray(stagger, float), (len(sensors),))
    total = sum(len(one.directions) for one in sensors)
    found = np.full((len(time), total), np.inf, np.float32)
    hit = np.empty(max(len(one.directions) for one in sensors), np.int32)
    order = np.argsort(late, kind="stable")
    starts = np.cumsum([0, *(len(one.directions) for one in sensors)])
    for step in range(len(time)):
        last = None
        for s in order:
            if late[s] != last:
                data.qpos[:] = _between(model, q, time, step, late[s])
                mujoco.mj_kinematics(model, data)
                last = late[s]
            one, (body, site) = sensors[s], placed[s]
            matrix = (data.xmat[body] if site < 0 else data.site_xmat[site]).reshape(3, 3)
            origin = (data.xpos[body] if site < 0 else data.site_xpos[site]) + matrix @ one.position
            count = len(one.directions)
            distance = np.empty(count)
            away = np.ascontiguousarray(one.directions @ matrix.T).ravel()
            mujoco.mj_multiRay(
                model, data, origin, away, None, True, -1, hit[:count], distance, None, count, 2 * one.maximum
            )
            found[step, starts[s] : starts[s + 1]] = np.where(hit[:count] >= 0, distance, np.inf)
    return Scan(np.asarray(time, float), np.asarray(q, float), found)


def _unseen(model: mujoco.MjModel, roots: set[int]) -> mujoco.MjModel:
    """Return a copy of a model in which trees of bodies are invisible, which MuJoCo's rays pass through."""
    found = copy.copy(model)
    own = np.isin(found.body_rootid[found.geom_bodyid], list(roots))
    found.geom_matid[own], found.geom_rgba[own, 3] = -1, 0
    return found


def _between(model: Any, q: NDArray[np.float64], time: NDArray[np.float64], step: int, late: float) -> Any:
    """The configuration `late` seconds before a sample, linear between samples; MuJoCo normalises quaternions."""
    if late == 0 or step == 0:
        return q[step]
    share = late / (time[step] - time[step - 1])
    return (1 - share) * q[step] + share * q[step - 1]


def _placed(model: Any, frame: str) -> tuple[int, int]:
    import mujoco

    if frame.startswith("site:"):
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, frame.removeprefix("site:"))
        if site >= 0:
            return int(model.site_bodyid[site]), site
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, frame)
    if body < 0:
        raise unknown_name("frame", frame, [model.body(i).name for i in range(1, model.nbody)])
    return body, -1


def corrupt(
    scan: Scan, sensors: Sequence[Proximity], faults: Faults, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Add noise and dropouts to ranges.

    Args:
        scan: T samples.
        sensors: the sensors that were cast.
        faults: `noise` and `dropout` are used.
        seed: of the noise.

    Returns:
        Readings (T, R) m, and which of them there are: zones that met something within the sensor's range.
    """
    random = np.random.default_rng([seed, 7004])
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, 0)
    white = random.standard_normal(ranges.shape, np.float32)
    reading = ranges * (1 + np.float32(faults.noise / SIGMAS) * white)
    low = np.repeat([s.minimum for s in sensors], [len(s.directions) for s in sensors])
    high = np.repeat([s.maximum for s in sensors], [len(s.directions) for s in sensors])
    there = np.isfinite(scan.ranges) & (reading >= low) & (reading <= high)
    if faults.dropout:
        there &= random.random(there.shape) >= faults.dropout
    return np.where(there, reading, 0).astype(np.float32), there


def encoders(angles: NDArray[np.float64], faults: Faults, seed: int) -> NDArray[np.float64]:
    """Return what encoders read at joint coordinates (T, n): biased, and noisy where `faults.encoder` says so."""
    random = np.random.default_rng([seed, 7005])
    return angles + np.asarray(faults.bias) + faults.encoder * random.standard_normal(angles.shape)


def save(scan: Scan, path: Path) -> None:
    """Keep a scan as NPZ, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, overwrite=True) as file:
        np.savez(file, time=scan.time, q=scan.q, ranges=scan.ranges)


def load(path: Path) -> Scan:
    """Read what `save` wrote; raises InputError where it is no scan."""
    with kept(path), path.open("rb") as file, np.load(file) as found:
        return Scan(found["time"], found["q"], found["ranges"])


__all__ = [
    "SIGMAS", "Faults", "Scan", "cast", "compiled", "corrupt", "crawl", "encoders", "inside", "load", "save",
    "touches",
]  # fmt: skip
