"""The config's table `[deflection]`: what may be in it, which sensors it describes, and a first one to edit."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxest.io import SensorLog
from jaxest.io.units import kind_of
from jaxest.types import InputError, unknown_name

NUMBERS = ("concentration", "offset", "variance", "lam", "mounting", "first_mounting", "second_mounting", "up")
ORDERS = ("wxyz", "xyzw")
ATTITUDES = ("ekf", "complementary", "madgwick")
PROPOSALS = ("guided", "bootstrap")
NOISES = ("von_mises", "gaussian")
TIPS = ("end_effector", "tip", "tool", "tcp", "marker")
SIDES = ("left", "right", "l", "r")


class Described(NamedTuple):
    """One sensor of the config."""

    sensor: Any
    """A `jaxest.sensors.Sensor`; of joints without their names yet."""
    stream: str
    """The stream that it reads; made from gyroscope and accelerometer where `imu` is given."""
    imu: str | None
    """Prefix of those, or None."""
    attitude: str
    """Filter that makes an orientation of them."""
    order: str
    """Of quaternions."""
    columns: tuple[int, ...] = ()
    """Of the stream, one for each of the sensor's joints; empty where it looks at frames, or not looked up yet."""


def schema() -> dict[str, Any]:
    """Return what may be in the config's table `[deflection]`, as `jaxest.io.config` takes it."""
    numbers = dict.fromkeys(NUMBERS, (float, list))
    words = dict.fromkeys(("kind", "stream", "imu", "attitude", "order", "frame"), str)
    return {
        "joints": list, "particles": int, "seed": int, "proposal": str, "noise": str, "truth": str,
        **dict.fromkeys(("walk", "prior", "start", "compliance"), (float, list)),
        "sensors": {"*": {**words, "frames": list, "joints": list, **numbers}},
    }  # fmt: skip


def sensors(settings: Mapping[str, Any]) -> list[Described]:
    """Read the sensors of a config.

    Args:
        settings: the table `[deflection]`.

    Returns:
        The sensors, in the config's order.

    Raises:
        InputError: there is none, a kind, choice or number is not one, or a frame or stream is not said.
    """
    tables = settings.get("sensors", {})
    if not tables:
        raise InputError(
            "[deflection] names no sensor; expected a --config with tables such as [deflection.sensors.encoders] "
            "(`jaxest inspect ROBOT` prints a first one)"
        )
    return [_described(name, table) for name, table in tables.items()]


def place(name: str) -> str:
    """Return where a sensor stands in the config, for messages."""
    return f"[deflection.sensors.{name}]"


def _described(name: str, table: Mapping[str, Any]) -> Described:
    from jaxest.sensors import KINDS, Sensor

    kind = table.get("kind", "")
    if kind not in KINDS:
        raise InputError(f"{place(name)}: {unknown_name('kind', kind, KINDS)}")
    _refuse_idle(name, kind, table)
    frames = tuple(table.get("frames", ())) or ((table["frame"],) if "frame" in table else ())
    wanted = KINDS[kind].FRAMES
    if len(frames) != wanted:
        many = f"frames = [...] with {wanted} names" if wanted > 1 else 'frame = "..."' if wanted else "no frame"
        raise InputError(f"{place(name)}: a {kind} looks at {wanted} frame(s), got {len(frames)}; expected {many}")
    if ("stream" in table) == ("imu" in table):
        raise InputError(f'{place(name)}: expected either stream = "..." or, for a raw IMU, imu = "..."')
    if "imu" in table and kind != "link_orientation":
        raise InputError(f"{place(name)}: imu is for a link_orientation, which a {kind} is not")
    for key, choices in (("order", ORDERS), ("attitude", ATTITUDES)):
        if key in table and table[key] not in choices:
            raise InputError(f"{place(name)}: {unknown_name(key, table[key], choices)}")
    sensor = Sensor(kind, name, frames or tuple(table.get("joints", ())), _params(name, kind, table))
    imu = table.get("imu")
    stream = table["stream"] if imu is None else f"{imu}/orientation" if imu else "orientation"
    return Described(sensor, stream, imu, table.get("attitude", ATTITUDES[0]), table.get("order", ORDERS[0]))


def _refuse_idle(name: str, kind: str, table: Mapping[str, Any]) -> None:
    """Refuse keys of a table that would do nothing."""
    from jaxest.sensors import KINDS

    turned = KINDS[kind].VALUE in ((4,), (7,)) and "imu" not in table
    for key, idle, why in (
        ("frame", "frames" in table, "frames is there too"),
        ("joints", KINDS[kind].FRAMES > 0, f"a {kind} looks at frames"),
        ("attitude", "imu" not in table, 'it is for a raw IMU, imu = "..."'),
        ("order", not turned, "it is for quaternions that are read from a stream"),
    ):
        if key in table and idle:
            raise InputError(f"{place(name)}: {key} is {table[key]!r} and would do nothing ({why}); leave it out")


def _params(name: str, kind: str, table: Mapping[str, Any]) -> Any:
    """The kind's parameters with the numbers of the table, checked."""
    import numpy as np

    from jaxest.sensors import KINDS, Sensor, check_params, default_params

    params = KINDS[kind].Params()
    nested = {field for field, value in params._asdict().items() if isinstance(value, tuple)}
    known: dict[str, tuple[str, ...]] = {f: () for f in params._fields if f not in nested}
    for part in nested:
        known |= dict.fromkeys(getattr(params, part)._fields, (part,))
    for key in NUMBERS:
        if key not in table:
            continue
        if key not in known:
            raise InputError(f"{place(name)}: {unknown_name(f'{kind} key', key, known)}")
        default = getattr(getattr(params, known[key][0]) if known[key] else params, key)
        value = np.asarray(table[key], float) if _numeric(table[key]) else None
        if value is None or (np.ndim(default) and value.shape not in ((), np.shape(default))) or (
            value.shape == () and key in ("lam", "mounting", "first_mounting", "second_mounting", "up")
        ):  # fmt: skip
            raise InputError(f"{place(name)}: {key} is {table[key]}, expected numbers of shape {np.shape(default)}")
        value = np.broadcast_to(value, np.shape(default)) if np.ndim(default) else value
        if known[key]:
            inner = getattr(params, known[key][0])._replace(**{key: value})
            params = params._replace(**{known[key][0]: inner})
        else:
            params = params._replace(**{key: value})
    one = (Sensor(kind, "sensor", ("",) * KINDS[kind].FRAMES, params),)
    try:
        check_params(one, default_params(one))
    except InputError as error:
        raise InputError(str(error).replace("sensor 'sensor'", place(name))) from error
    return params


def _numeric(value: Any) -> bool:
    flat = value if isinstance(value, list) else [value]
    return bool(flat) and all(isinstance(x, int | float) and not isinstance(x, bool) for x in flat)


def of_robot(joints: Mapping[str, str], frames: Sequence[str]) -> str:
    """Write a first config from a robot's names.

    Args:
        joints: kinds of the joints by their names.
        frames: names of the frames.

    Returns:
        TOML text: encoders (a stream an arm where names tell arms apart), an orientation for each site that sounds like
        an IMU, a position for one at the end. Slides and balls are named, as only hinges are estimated otherwise.
    """
    hinges, slides, balls = ([n for n, kind in joints.items() if kind == k] for k in ("hinge", "slide", "ball"))
    named = f"joints = {json.dumps([*hinges, *slides, *balls])}\n" if slides or balls else ""
    sites = [frame.removeprefix("site:") for frame in frames if frame.startswith("site:")]
    imus = [site for site in sites if "imu" in site.lower()]
    tips = [s for s in sites if any(word in s.lower() for word in TIPS)]
    arms = _arms([*hinges, *slides])
    found = []
    for arm, owned in arms.items():
        stream, some = f"{arm}/joint_position".lstrip("/"), len(arms) > 1
        for kind, write in ((hinges, _encoders), (slides, _slides)):
            mine = [name for name in kind if name in owned]
            found += [write(stream, mine, arm, some)] if mine else []
    found += [_table(imu, "link_orientation", f"{imu}/orientation", f"site:{imu}") for imu in imus]
    found += [_table(tip, "link_position", f"{tip}/position", f"site:{tip}") for tip in tips]
    return f"[deflection]\n{named}\n" + "\n".join(found)


def _arms(names: Sequence[str]) -> dict[str, set[str]]:
    """Joints by the arm that each name begins with (`right_elbow`, `a/elbow`), as logs have them; else all of none."""
    found: dict[str, set[str]] = {}
    for name in names:
        side, _, rest = name.partition("_")
        arm = name.rpartition("/")[0] or (side if rest and side.lower() in SIDES else "")
        found.setdefault(arm, set()).add(name)
    return found if len(found) > 1 and "" not in found else {"": set(names)}


def of_log(log: SensorLog) -> str:
    """Write a first config from a log's streams; nothing where it is no log of joints and of sensors on links.

    Args:
        log: the log.

    Returns:
        TOML text; frames are guessed from the streams' names and are to be checked against the robot.
    """
    names = list(log.streams)
    encoders = next((name for name in names if kind_of(name) == "joint_position"), None)
    found = []
    taken: set[str] = set()
    for name in names:
        owner = name.rpartition("/")[0]
        if owner and kind_of(name) in ("orientation", "position"):
            kind = "link_orientation" if kind_of(name) == "orientation" else "link_position"
            found.append(_table(_own(owner, kind, taken), kind, name, _frame(owner)))
        elif owner and _raw(name, owner, names):
            found.append(_table(_own(owner, "imu", taken), "link_orientation", "", _frame(owner), imu=owner))
    if encoders is None or not found:
        return ""
    return "[deflection]\n\n" + "\n".join([_encoders(encoders, log.streams[encoders].names), *found])


def _raw(name: str, owner: str, names: Sequence[str]) -> bool:
    """Whether a stream is the gyroscope of an IMU that has an accelerometer and no orientation."""
    there = kind_of(name) == "gyroscope" and f"{owner}/accelerometer" in names
    return there and f"{owner}/orientation" not in names


def _frame(owner: str) -> str:
    """A guess at the frame that a stream's owner is: a site where it sounds like a sensor or a tip, else a body."""
    return f"site:{owner}" if any(word in owner.lower() for word in ("imu", *TIPS)) else owner


def _own(owner: str, what: str, taken: set[str]) -> str:
    """A name for a sensor's table that no other has, added to those taken."""
    name = _identifier(owner)
    if name in taken:
        name = f"{name}_{what.removeprefix('link_')}"
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _identifier(name: str) -> str:
    plain = "".join(c if c.isalnum() else "_" for c in name)
    return plain if plain.isidentifier() and not plain.startswith("_") else f"sensor_{plain.strip('_')}"


def _encoders(stream: str, joints: Sequence[str], arm: str = "", some: bool = False) -> str:
    return (
        f'[deflection.sensors.{_of(arm, "encoders")}]\nkind = "joint_angle"\nstream = {json.dumps(stream)}\n'
        f"{_columns(joints, some)}"
        "concentration = 15.0  # 1 / sd^2, sd in rad: 15 deg of bend; yours, or one for each joint: bands rest on it\n"
    )


def _slides(stream: str, joints: Sequence[str], arm: str = "", some: bool = False) -> str:
    return (
        f'[deflection.sensors.{_of(arm, "slides")}]\nkind = "slide_position"\nstream = {json.dumps(stream)}\n'
        f"{_columns(joints, some)}"
        "variance = 1e-4  # sd^2, sd in m: how far slides may be from what is read, 1 cm here\n"
    )


def _of(arm: str, what: str) -> str:
    return _identifier(f"{arm}_{what}") if arm else what


def _columns(joints: Sequence[str], some: bool) -> str:
    """Whose the columns are: said where they are some of the robot's joints, else for whoever needs it."""
    line = f"joints = {json.dumps(list(joints))}  # of the columns, in this order\n"
    return ("" if some else "# ") + line if joints else ""


def _table(name: str, kind: str, stream: str, frame: str, imu: str = "") -> str:
    source = f"imu = {json.dumps(imu)}  # raw: gyroscope and accelerometer" if imu else f"stream = {json.dumps(stream)}"
    noise = (
        "variance = [0.01, 0.01, 0.01]  # sd^2 along the world's axes, 10 cm here; 5 mm is 2.5e-5"
        if kind == "link_position"
        else "lam = [0, -800, -800, 0]  # -2 / sd^2 about x, y, z: 3 deg; 0 says nothing of a yaw that drifts"
    )
    return (
        f"[deflection.sensors.{_identifier(name)}]\nkind = {json.dumps(kind)}\n{source}\n"
        f"frame = {json.dumps(frame)}  # of the robot; check\n{noise}\n"
    )
