"""What the name of an array or column says: which kind of stream, whose, which component, which unit."""

import itertools
import re
from typing import NamedTuple

from jaxest.io import units
from jaxest.types import InputError


class Word(NamedTuple):
    """A name taken apart."""

    kind: str
    """Stream name, `time`, `rate`, `period`, or nothing where the name says nothing."""
    owner: str
    """What is left of the name: `imu0` in `imu0_gyr_x`, `cmd` in `dq_cmd`."""
    component: str
    """`x`, `y`, `z`, `w`, a number or a joint's name, or nothing."""
    unit: str
    """Of a name with a kind as it is in brackets, whether or not it is a unit of the kind (`fits`)."""


_KINDS = {
    "gyroscope": "gyr gyro gyros gyroscope omega angvel w gyroskop drehrate",
    "accelerometer": "acc accel accelerometer acceleration a beschleunigung",
    "magnetometer": "mag magn magnetometer magnetic compass m magnetfeld",
    "orientation": "quat quaternion orientation attitude",
    "joint_position": "q qpos positions angles jointangles",
    "joint_velocity": "dq qd qvel qdot velocities",
    "joint_acceleration": "ddq qdd qacc accelerations",
    "joint_torque": "tau torque torques effort efforts",
    "time": "t time times stamp stamps timestamp timestamps datetime "
    "seconds milliseconds microseconds nanoseconds millis micros nanos zeit zeitstempel temps tiempo",
    "rate": "fs rate hz freq frequency samplerate fsamp",
    "period": "dt ts period",
}
_OF = {word: kind for kind, words in _KINDS.items() for word in words.split()}
_PAIRS = {
    ("angular", "velocity"): "gyroscope", ("ang", "vel"): "gyroscope", ("angular", "rate"): "gyroscope",
    ("linear", "acceleration"): "accelerometer", ("specific", "force"): "accelerometer",
    ("magnetic", "field"): "magnetometer", ("sampling", "rate"): "rate", ("sample", "rate"): "rate",
    ("sampling", "frequency"): "rate", ("sampling", "period"): "period", ("sample", "time"): "period",
}  # fmt: skip
# Words that mean something else unless the name speaks of joints.
_JOINT = {"pos": "position", "position": "position", "angle": "position", "vel": "velocity", "velocity": "velocity",
          "acc": "acceleration", "acceleration": "acceleration", "gyr": "velocity"}  # fmt: skip
_OF_ANGLES = {"rad": (("pos", "position", "angle", "winkel"), "joint_position"),
              "rad/s": (("vel", "velocity"), "joint_velocity")}  # fmt: skip
"""Words that speak of a joint where the name states such a unit: `shoulder_pos [deg]`."""
_EMPTY = {"raw", "data", "imu", "field", "sensor", "meas", "measured", "value", "values", "joint", "joints", "ros",
          "elapsed", "date", "utc", "unix", "epoch"}  # fmt: skip
_ENCODERS = ("enc", "encoder", "encoders")
_SHORT = ("g", "a", "m", "w", "q", "gyr", "gyro", "acc", "accel", "mag", "quat", "dq", "qd", "ddq", "tau", "omega")
_UNIT_TOKENS = {
    "dps": "deg/s", "deg": "deg", "rad": "rad", "rads": "rad/s", "degs": "deg/s", "ut": "uT", "nt": "nT", "nm": "Nm",
    "ms2": "m/s2", "g": "g", "mg": "mg", "s": "s", "sec": "s", "ms": "ms", "us": "us", "ns": "ns",
    "seconds": "s", "milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns",
    "millis": "ms", "micros": "us", "nanos": "ns",
}  # fmt: skip
_BARE = ("sec", "ms", "us", "ns")  # what a clock is called that is called by its unit and nothing else
_LONG_UNITS = {"deg_s": "deg/s", "deg_per_s": "deg/s", "rad_s": "rad/s", "rad_per_s": "rad/s", "m_s2": "m/s2",
               "m_s_2": "m/s2", "m_per_s2": "m/s2"}  # fmt: skip
_BEHIND_AXES = {unit.lower(): unit for unit in ("m", "cm", "mm", "uT", "nT", "mT", "g", "rad", "deg")}
_BEHIND_AXES |= {"dps": "deg/s", "degs": "deg/s", "rads": "rad/s", "ms2": "m/s2", "gauss": "G"}
_LONG = re.compile(rf"^(.*[^\W_])[\W_]+({'|'.join(_LONG_UNITS)})$", re.IGNORECASE)
_BEHIND = re.compile(rf"^((?:.*[\W_])?[wxyz])[\W_]+({'|'.join([*_BEHIND_AXES, 'mg'])})$", re.IGNORECASE)
_CLOCKS = ("seconds", "milliseconds", "microseconds", "nanoseconds", "millis", "micros", "nanos")
_AXES = ("w", "x", "y", "z")


def classify(name: str) -> Word:
    """Take a name apart.

    Args:
        name: of an array (NPZ) or column (CSV), for example `imu0_gyr_x [deg/s]`.

    Returns:
        Its meaning.
    """
    bracket = re.search(r"[\[(]([^\])]+)[\])]\s*$", name)
    unit = ""
    if bracket:
        unit, name = bracket.group(1).strip(), name[: bracket.start()]
    else:
        name, unit = _unit_behind(name)
    tokens = [t.lower() for t in re.findall(r"[A-Z]+(?![a-z])[0-9]*|[A-Z]?[a-z]+[0-9]*|[0-9]+", name)]
    if len(tokens) == 1 and tokens[0] in _BARE and not unit:
        return Word("time", "", "", _UNIT_TOKENS[tokens[0]])
    tokens, component = _component(tokens)
    before = tokens
    tokens, kind = _kind(tokens, component)
    if not kind and tokens[-1:] == ["joint"]:  # `arm_j0`, `elbow_joint`: a robot's joint by its name
        kind, tokens, component = ("joint_position", tokens, component) if component else _by_name(tokens)
    if not kind and tokens[:1] and tokens[0] in _ENCODERS:  # `enc_elbow`, `encoder_3`
        kind, component = "joint_position", component or "_".join(t for t in tokens[1:] if t not in _UNIT_TOKENS)
        tokens = [t for t in tokens[1:] if t in _UNIT_TOKENS]
    if kind == "time" and not unit:  # a clock may be called by its unit: `millis`
        unit = next((_UNIT_TOKENS[t] for t in before if t in _CLOCKS), "")
    if not unit and tokens and fits(kind, _UNIT_TOKENS.get(tokens[-1], "")):
        unit = _UNIT_TOKENS[tokens[-1]]
        tokens = tokens[:-1]
    unit = unit if fits(kind, unit) or (bracket and kind and _states(unit)) else ""
    if unit and not kind and not component:
        tokens, kind, component = _joint(tokens, unit)
    # A word that says the kind once more is nobody's name: `Quat_q0`, `time_stamp`.
    owner = [t for t in tokens if t not in _EMPTY and not (_OF.get(t) == kind and len(t) > 1) and not _again(t, kind)]
    return Word(kind, "_".join(owner), component, unit)


def _unit_behind(name: str) -> tuple[str, str]:
    """Split off a unit that is several words, or stands behind an axis: `gyr_x_deg_s`, `acc_x_g`, `tool_x_mm`."""
    found = _LONG.match(name)
    if found:
        return found.group(1), _LONG_UNITS[found.group(2).lower()]
    found = _BEHIND.match(name)
    if not found:
        return name, ""
    unit = found.group(2)
    return found.group(1), unit if unit in units.UNITS else _BEHIND_AXES.get(unit.lower(), "")


def _again(token: str, kind: str) -> bool:
    return kind == "orientation" and token == "q"


def _joint(tokens: list[str], unit: str) -> tuple[list[str], str, str]:
    """Take the name of a joint's angle or speed apart, by its unit: what is left is the joint."""
    words, kind = _OF_ANGLES.get(units.lookup(unit).si, ((), ""))
    at = next((i for i, token in enumerate(tokens) if token in words), None)
    if at is None or len(tokens) < 2:
        return tokens, "", ""
    return [], kind, "_".join(tokens[:at] + tokens[at + 1 :])


def _by_name(tokens: list[str]) -> tuple[str, list[str], str]:
    """What is left of a joint's name before `joint` is its component."""
    name = "_".join(tokens[:-1])
    return ("joint_position", [], name) if name else ("", tokens, "")


def _states(text: str) -> bool:
    """Say whether what is in brackets is to be understood as a unit: `[0]`, `(-)` and `(UTC)` are not."""
    return any(letter.isalpha() for letter in text) and text.lower() not in _EMPTY


def fits(kind: str, unit: str) -> bool:
    """Say whether the unit can belong to the kind, so that `g` is gravity only behind an acceleration."""
    try:
        entry = units.for_stream(kind, unit)
    except InputError:
        return False
    return entry.si == "s" if kind == "time" else bool(kind in units.KINDS or not kind)


def _component(tokens: list[str]) -> tuple[list[str], str]:
    """Split off the axis or number: `gx`, `gyr_x`, `q3`, `joint_3_position`."""
    if len(tokens) > 1 and (tokens[-1] in _AXES or tokens[-1].isdigit()):
        return tokens[:-1], tokens[-1]
    joint = next((i for i, t in enumerate(tokens) if re.fullmatch(r"(joint|j)[0-9]+", t)), None)
    if joint is not None:
        return [*tokens[:joint], "joint", *tokens[joint + 1 :]], re.sub(r"\D", "", tokens[joint])
    joint = next((i for i, t in enumerate(tokens[:-1]) if t == "joint" and tokens[i + 1].isdigit()), None)
    if joint is not None:
        return [*tokens[: joint + 1], *tokens[joint + 2 :]], tokens[joint + 1]
    for i, token in enumerate(tokens):
        found = re.fullmatch(rf"({'|'.join(_SHORT)})([wxyz]|[0-9]+)", token)
        if found:
            base = "gyr" if found.group(1) == "g" else found.group(1)
            return [*tokens[:i], base, *tokens[i + 1 :]], found.group(2)
    return tokens, ""


def _kind(tokens: list[str], component: str) -> tuple[list[str], str]:
    """Find the words that name a kind and take them out."""
    for i, pair in enumerate(itertools.pairwise(tokens)):
        if pair in _PAIRS:
            return tokens[:i] + tokens[i + 2 :], _PAIRS[pair]
    for i, token in enumerate(tokens):  # `gyr_time` is a time
        if _OF.get(token) in ("time", "rate", "period"):
            return tokens[:i] + tokens[i + 1 :], _OF[token]
    for i, token in enumerate(tokens):
        if ("joint" in tokens or "joints" in tokens) and token in _JOINT:
            return tokens[:i] + tokens[i + 1 :], f"joint_{_JOINT[token]}"
    for i, token in sorted(enumerate(tokens), key=lambda x: len(x[1]) == 1):  # `imu_a_acc` is an accelerometer of `a`
        single = token in ("a", "m", "w")  # one letter means something only with an axis: `ax`
        if token in _OF and not (single and component not in ("x", "y", "z")):
            return tokens[:i] + tokens[i + 1 :], "orientation" if token == "q" and component in _AXES else _OF[token]
    return tokens, ""
