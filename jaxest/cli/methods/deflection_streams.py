"""From a log's streams to the deflection filter's measurements, with a word for each reading that cannot be."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.cli.methods import imu_steps
from jaxest.cli.methods.deflection_config import Described, place
from jaxest.cli.methods.deflection_joints import Joints
from jaxest.io import SensorLog, Stream, ticks
from jaxest.io.log import finite_rows, refuse_nan, stream, where
from jaxest.types import InputError, Reading, unknown_name

UNIT_LENGTH = 0.02  # what a recorded unit quaternion may be off
FAR, NEAR = 0.6, 0.25  # rad: tilts that a posture cannot explain, and that it can
RAW = imu_steps.KINDS[:2]  # of an IMU, what an orientation is made from
SPARSE = 0.5  # share of a sensor's rows with numbers below which that is told
ENCODERS = ("joint_angle", "slide_position")  # kinds that read joints
REMEDY = 'nan = "missing" in a config'


def on_robot(log: SensorLog, robot: Any, joints: Joints, one: Described) -> Described:
    """Check a sensor's frames, and find its joints among the columns of its stream.

    Args:
        log: the log.
        robot: the robot.
        joints: the estimated joints.
        one: the sensor.

    Returns:
        The sensor with the names of its joints.

    Raises:
        InputError: a frame, joint or stream does not exist; the closest names are given.
    """
    from jaxest.sensors import KINDS

    kind = KINDS[one.sensor.kind]
    if kind.FRAMES:
        for frame in one.sensor.frames:
            if frame not in robot.frame_names:
                raise InputError(f"{place(one.sensor.name)}: {unknown_name('frame', frame, robot.frame_names)}")
        return one
    item = stream(log, one.stream)
    given = one.sensor.frames or item.names
    for name in one.sensor.frames:
        if name not in robot.joint_names:
            raise InputError(f"{place(one.sensor.name)}: {unknown_name('joint', name, robot.joint_names)}")
    names = joints.of(kind.JOINTS)
    if not names:
        raise InputError(f"{place(one.sensor.name)}: no {kind.JOINTS} is estimated; name it in joints = [...]")
    found = columns(item._replace(names=tuple(given)), f"{where(log)}stream {one.stream!r}", names)
    sensor = one.sensor._replace(frames=tuple(names[at] for at in found))
    return one._replace(sensor=sensor, columns=tuple(found.values()))


def columns(item: Stream, spot: str, names: tuple[str, ...]) -> dict[int, int]:
    """Return which column of a stream belongs to which estimated joint.

    Args:
        item: the stream; its names decide, and without names its columns are the joints.
        spot: where it stands, for messages.
        names: of the estimated joints.

    Returns:
        Column by number of the joint, in the joints' order.

    Raises:
        InputError: the columns do not fit.
    """
    width = int(np.prod(item.value.shape[1:]))
    if not item.names and width != len(names):
        raise InputError(
            f"{spot}: {width} columns without names for {len(names)} joints ({', '.join(names)}); say in the config "
            "whose they are: joints = [...]"
        )
    given = item.names or names
    if len(given) != width:
        raise InputError(f"{spot}: {len(given)} joints named for {width} columns")
    found = {at: given.index(name) for at, name in enumerate(names) if name in given}
    if not found:
        raise InputError(
            f"{spot}: its columns are {', '.join(given)}, none of the joints {', '.join(names)}; expected these names, "
            "or a sensor's joints = [...] in the config that says whose they are"
        )
    return found


def measurements(
    log: SensorLog, robot: Any, joints: Joints, described: list[Described], nan: str
) -> tuple[Any, Any, list[str]]:
    """Merge the sensors' streams into steps.

    Args:
        log: the log in SI units.
        robot: the robot.
        joints: the estimated joints.
        described: the sensors, from `on_robot`.
        nan: `error`, or `missing`.

    Returns:
        The steps, measurements with a leading time axis, and notes.

    Raises:
        InputError: a stream is missing, of the wrong shape, not finite, or of quaternions that cannot be.
    """
    from jaxest.sensors import measurement_type

    streams, notes = {}, []
    for one in described:
        name = one.sensor.name
        if one.imu is not None:
            streams[name], lacks = _attitude(log, one, nan)
            notes += [f"{name}: {said}" for said in (f"orientation from raw readings by {one.attitude}", *lacks)]
        else:
            streams[name] = _read(log, one, nan)
    _right_order(log, robot, joints.names, described, streams)
    fastest = max(streams.values(), key=lambda item: len(item.time)).time
    tolerance = float(np.median(np.diff(fastest))) / 2 if len(fastest) > 1 else 0.0
    notes += [note for one in described for note in _sparse(one, streams[one.sensor.name].value)]
    encoders = [one.sensor.name for one in described if one.sensor.kind in ENCODERS]
    steps = ticks(SensorLog(streams, log.source), tolerance=tolerance, nan="invalid", dtype=np.float32, apart=encoders)
    record = measurement_type([one.sensor for one in described])
    readings = {one.sensor.name: steps.readings[one.sensor.name] for one in described}
    notes += [f"used {', '.join(dict.fromkeys(one.stream for one in described))}"]
    return steps, record(**readings, dt=steps.dt), notes


def _sparse(one: Described, value: NDArray[Any]) -> list[str]:
    """Say what of a sensor is missing in more than half of its rows: it, or an encoder of some of its joints."""
    parts = {one.sensor.name: finite_rows(value)}
    if one.sensor.kind in ENCODERS:
        columns = zip(one.sensor.frames, value.T, strict=True)
        parts = {f"{one.sensor.name}, {joint}": np.isfinite(column) for joint, column in columns}
    return [f"{part}: {np.sum(~there)} of {len(there)} rows are missing" for part, there in parts.items()
            if there.mean() < SPARSE]  # fmt: skip


def _read(log: SensorLog, one: Described, nan: str) -> Stream:
    """A sensor's stream as its kind wants it, checked."""
    from jaxest.sensors import KINDS

    item, spot = stream(log, one.stream), f"{where(log)}stream {one.stream!r}"
    if nan == "error":
        refuse_nan(item, spot, REMEDY)
    if not KINDS[one.sensor.kind].FRAMES:
        return item._replace(value=item.value.reshape(len(item.time), -1)[:, list(one.columns)], names=())
    shape = KINDS[one.sensor.kind].VALUE
    if item.value.shape[1:] != shape:
        raise InputError(f"{spot}: has shape {item.value.shape}, expected (n, {shape[0]}) for a {one.sensor.kind}")
    if shape in ((4,), (7,)):
        value = item.value.astype(np.float64)
        if one.order == "xyzw":
            value[:, -4:] = value[:, [-1, -4, -3, -2]]
        item = item._replace(value=_unit(item, value, spot))
    return item


def _unit(item: Stream, value: NDArray[np.float64], spot: str) -> NDArray[np.float64]:
    length = np.linalg.norm(value[:, -4:], axis=1)
    off = np.abs(length - 1) > UNIT_LENGTH  # False where NaN
    if off.any():
        row = int(np.argmax(off))
        raise InputError(
            f"{spot}: row {row} at {item.time[row]:.6f} s is a quaternion of length {length[row]:.4g}, expected 1 "
            f"({int(off.sum())} of {len(off)} rows)"
        )
    value[:, -4:] /= np.where(np.isfinite(length), length, 1.0)[:, None]
    return value


def _attitude(log: SensorLog, one: Described, nan: str) -> tuple[Stream, list[str]]:
    """Orientations from a raw gyroscope and accelerometer, NaN until the filter has settled, and notes."""
    from jaxest.cli.methods import orientation_filters
    from jaxest.filters.imu import Imu

    prefix = f"{one.imu}/" if one.imu else ""
    steps = imu_steps.merged(log, [prefix], RAW, nan)
    gyr, acc = (steps.readings[prefix + kind] for kind in RAW)
    chosen = orientation_filters.choose({"filter": one.attitude})
    found = orientation_filters.run(chosen, RAW, Imu(gyr, acc, None, steps.dt))
    quaternion = np.where(found.valid[:, None], found.quaternion, np.nan)
    return Stream(steps.time, quaternion, "1", "earth"), imu_steps.rateless(steps, [prefix])


def _right_order(
    log: SensorLog, robot: Any, names: tuple[str, ...], described: list[Described], streams: dict[str, Stream]
) -> None:
    """Refuse quaternions that only fit the posture that encoders read when they are taken as xyzw, or inverted."""
    encoders = next((one for one in described if one.sensor.kind == "joint_angle"), None)
    if encoders is None or len(encoders.sensor.frames) != len(names):
        return
    read = streams[encoders.sensor.name]
    for one in described:
        if one.sensor.kind != "link_orientation" or one.imu is not None:
            continue
        item = streams[one.sensor.name]
        rows = np.flatnonzero(finite_rows(item.value))[:: max(1, len(item.time) // 200)]
        near = np.clip(np.searchsorted(read.time, item.time[rows]), 0, len(read.time) - 1)
        kept = finite_rows(read.value)[near]
        rows, near = rows[kept], near[kept]
        if not rows.size:
            continue
        up = _up(_predicted(robot, names, one, np.asarray(read.value)[near]))
        q = item.value[rows]
        other = q[:, [3, 0, 1, 2]] if one.order == "wxyz" else q[:, [1, 2, 3, 0]]
        away = [_tilt(_up(x), up) for x in (q, other, q * [1, -1, -1, -1])]
        if away[0] <= FAR or min(away[1:]) >= NEAR:
            continue
        spot = f"{where(log)}stream {one.stream!r}: as {one.order} it tilts {np.rad2deg(away[0]):.0f} deg"
        if away[1] < away[2]:
            right = "xyzw" if one.order == "wxyz" else "wxyz"
            raise InputError(
                f"{spot} from the posture that the encoders read, as {right} {np.rad2deg(away[1]):.0f} deg; the "
                f'quaternions seem to be {right}: say order = "{right}" in {place(one.sensor.name)}'
            )
        raise InputError(
            f"{spot} from the posture that the encoders read, inverted {np.rad2deg(away[2]):.0f} deg; it seems to map "
            "world to sensor, expected sensor to world"
        )


def _predicted(robot: Any, names: tuple[str, ...], one: Described, angles: NDArray[Any]) -> NDArray[np.float64]:
    """Orientations (n, 4) that a sensor would have on a rigid robot at angles (n, d)."""
    import jax
    import jax.numpy as jnp

    from jaxest.kinematics import forward
    from jaxest.sensors import link_orientation

    at = np.array([robot.topology.joint_q[robot.joint_names.index(name)] for name in names])
    q = np.tile(np.asarray(robot.home, np.float32), (len(angles), 1))
    q[:, at] = angles

    def look(q: Any) -> Any:
        return link_orientation.predict(one.sensor.params, forward(robot, q, one.sensor.frames))

    return np.asarray(jax.jit(jax.vmap(look))(jnp.asarray(q)), np.float64)


def _up(q: NDArray[Any]) -> NDArray[np.float64]:
    """The vertical (n, 3) in the sensor's frame, of orientations (n, 4) wxyz."""
    w, x, y, z = np.asarray(q, np.float64).T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z], axis=1)


def _tilt(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Median angle, rad, between unit vectors (n, 3)."""
    return float(np.median(np.arccos(np.clip(np.sum(one * other, axis=1), -1, 1))))


def reference(described: list[Described], recorded: Any, joints: Joints) -> NDArray[np.float64] | None:
    """Return what encoders read (T, c) rad and m, NaN where they did not; None without encoders.

    Args:
        described: the sensors.
        recorded: measurements with a leading time axis.
        joints: the estimated joints, c of them hinges and slides.
    """
    encoders = [one for one in described if one.sensor.kind in ENCODERS]
    value = np.full((len(recorded.dt), len(joints.numbers)), np.nan)
    for one in reversed(encoders):  # the first counts where several read a joint
        reading: Reading = getattr(recorded, one.sensor.name)
        at = [joints.numbers.index(name) for name in one.sensor.frames]
        there = np.broadcast_to(np.asarray(reading.valid).reshape(len(value), -1), (len(value), len(at)))
        value[:, at] = np.where(there, np.asarray(reading.value), value[:, at])
    return value if encoders else None
