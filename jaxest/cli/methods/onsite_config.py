"""The config's table `[onsite]`: two IMUs on one link, or the modules of a whole robot; and a first one to edit.

```toml
[onsite]                              # two IMUs
first = "imu0"                        # its frame is kept; streams imu0/gyroscope and imu0/accelerometer
second = "imu1"
calibration = "imus.json"             # as jaxest.calibration.imu.save writes it
gyroscope_axes = 0.01                 # what axes may be off in scale and direction; without it the calibration's word,
accelerometer_axes = 0.01             # or 1 %
gyroscope_bias = 0.3                  # rad/s, standard deviation of either gyro's bias, and m/s2 of an accelerometer's;
accelerometer_bias = 0.3              # without it usual ones, or the calibration's
window = 0.07                         # s, half of the live estimate's; with what follows `jaxest tune` finds it
gyroscope_noise = 0.01                # rad/s a sample
forgetting_rotation = 1.0             # what a live estimate keeps at each sample; below 1 for links that move
forgetting_position = 1.0
force_noise = 0.1                     # m/s2 a sample, for `jaxest tune` alone
clocks = true                         # look for an offset between the IMUs' clocks and take it off
position = [-0.2, 0, 0]               # m, the truth, if it is known: its error is printed
quaternion = [1, 0, 0, 0]             # likewise

[onsite.modules.joint1]               # or a robot: its modules, from the base outwards
axis = [0, 0, 1]
limits = [-2.6, 2.6]                  # rad
place = { position = [0, 0, 0.25] }   # in the horn of the module before (of the first: in the world); where it is
                                      # missing, the link is to be found
before = { imu = "imu1", position = [-0.03, 0, 0.015], quaternion = [1, 0, 0, 0] }
after = { imu = "imu2", position = [0.03, 0, 0.015] }

[onsite.tool]                         # the gripper in the last module's horn
position = [0.1, 0, 0]
```

A robot is known when two standard deviations are below `position_limit` (m, 0.005) and `rotation_limit_deg` (0.1), keys
of `[onsite]`.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.kinematics import modular
from jaxest.manifolds.se3 import Pose
from jaxest.types import InputError

PLACE = {"position": list, "quaternion": list}
MOUNTING = {"imu": str, **PLACE}


OF_PAIRS = ("gyroscope_bias", "accelerometer_bias", "clocks", "position", "quaternion")
OF_ROBOTS = ("tool", "position_limit", "rotation_limit_deg")


class Truth(NamedTuple):
    """What is known of the second IMU's pose in the first."""

    position: NDArray[np.float64] | None
    """(3,) m."""
    quaternion: NDArray[np.float64] | None
    """(4,) wxyz."""


class Modules(NamedTuple):
    """A robot as the config describes it."""

    assembly: modular.Assembly
    imus: tuple[tuple[str, str], ...]
    """Names of the IMUs before and behind each unknown link."""


def schema() -> dict[str, Any]:
    """Return what may be in the config's table `[onsite]`, as `jaxest.io.config` takes it."""
    module = {"axis": list, "limits": list, "place": PLACE, "before": MOUNTING, "after": MOUNTING}
    words = dict.fromkeys(("first", "second", "calibration"), str)
    names = ("gyroscope_bias", "accelerometer_bias", "gyroscope_axes", "accelerometer_axes")
    live = ("window", "gyroscope_noise", "forgetting_rotation", "forgetting_position", "force_noise")
    numbers = dict.fromkeys((*names, *live, "position_limit", "rotation_limit_deg"), float)
    return {**words, **numbers, **PLACE, "clocks": bool, "modules": {"*": module}, "tool": PLACE}


def modules(settings: Mapping[str, Any]) -> Modules:
    """Read the modules of a robot.

    Args:
        settings: the table `[onsite]`.

    Returns:
        The robot.

    Raises:
        InputError: a number is missing or has the wrong shape, or the modules make no robot; the table is named.
    """
    made, links, names = [], [], []
    for name, table in settings["modules"].items():
        spot = f"[onsite.modules.{name}]"
        sides = {side: _pose(f"{spot} {side}", table[side]) for side in ("before", "after") if side in table}
        axis = _numbers(f"{spot} axis", table.get("axis", [0, 1, 0]), 3)
        limits = _numbers(f"{spot} limits", table.get("limits", [-np.pi / 2, np.pi / 2]), 2)
        x, y, z = axis
        low, high = limits
        made.append(modular.Module(name, sides.get("before"), sides.get("after"), (x, y, z), (low, high)))
        links.append(_pose(f"{spot} place", table["place"]) if "place" in table else None)
        names.append({side: table[side].get("imu", f"{name}_{side}") for side in sides})
    base = links[0] or modular.STILL
    tool = _pose("[onsite.tool]", settings["tool"]) if "tool" in settings else modular.STILL
    assembly = modular.check(modular.Assembly(tuple(made), tuple(links[1:]), base, tool))
    if not assembly.unknown:
        raise InputError("[onsite.modules]: every module has a `place`; leave it out where a link is to be found")
    return Modules(assembly, tuple((names[k]["after"], names[k + 1]["before"]) for k in assembly.unknown))


def _pose(spot: str, table: Mapping[str, Any]) -> Pose:
    turn = np.array(_numbers(f"{spot} quaternion", table.get("quaternion", [1, 0, 0, 0]), 4))
    length = float(np.linalg.norm(turn))
    if abs(length - 1) > 0.02:
        raise InputError(f"{spot}: quaternion of length {length:.4g}, expected 1 (wxyz)")
    place = np.array(_numbers(f"{spot} position", table.get("position", [0, 0, 0]), 3))
    return modular.known(turn / length, place)


def _numbers(spot: str, value: Any, size: int) -> list[float]:
    good = isinstance(value, list) and len(value) == size
    if not good or not all(isinstance(x, int | float) and not isinstance(x, bool) and np.isfinite(x) for x in value):
        raise InputError(f"{spot}: got {value}, expected {size} numbers")
    return [float(x) for x in value]


def truth(settings: Mapping[str, Any]) -> Truth:
    """Return what the config knows of the pose."""
    known = _pose("[onsite]", {key: settings[key] for key in PLACE if key in settings})
    return Truth(*(np.asarray(value) if key in settings else None
                   for key, value in (("position", known.translation), ("quaternion", known.rotation))))  # fmt: skip


def refuse_idle(settings: Mapping[str, Any]) -> None:
    """Refuse keys that say nothing of what is estimated, two IMUs or a robot; raises InputError."""
    idle, of = (OF_PAIRS, "two IMUs") if "modules" in settings else (OF_ROBOTS, "a robot")
    found = next((key for key in idle if key in settings), None)
    if found is not None:
        here = "[onsite.modules] describes a robot" if "modules" in settings else "there is no [onsite.modules]"
        raise InputError(f"[onsite] {found}: is of {of}, and {here}; leave it out")


def of_log(imus: Sequence[str]) -> str:
    """Write a first config from the names of a log's IMUs; nothing where there are fewer than two.

    Args:
        imus: names.

    Returns:
        TOML text: a pair, or, of more than two, the modules that they may belong to, to be edited.
    """
    if len(imus) < 2:
        return ""
    pair = f"[onsite]  # two IMUs on one rigid link\nfirst = {json.dumps(imus[0])}\nsecond = {json.dumps(imus[1])}\n"
    if len(imus) == 2:
        return pair
    lines = [pair, "# or a robot of joint modules, from the base outwards; mountings in m and wxyz, to be measured:"]
    count = (len(imus) + 1) // 2 + 1
    for k in range(count):
        lines.append(f"# [onsite.modules.joint{k + 1}]\n# axis = [0, 1, 0]")
        lines += (
            ["# place = { position = [0, 0, 0] }  # of the base; without it the link is to be found"] if not k else []
        )
        for side, at in (("before", 2 * k - 1), ("after", 2 * k)):
            if 0 <= at < len(imus):
                lines.append(
                    f"# {side} = {{ imu = {json.dumps(imus[at])}, position = [0, 0, 0], quaternion = [1, 0, 0, 0] }}"
                )
    return "\n".join(lines) + "\n"


__all__ = ["Modules", "Truth", "modules", "of_log", "refuse_idle", "schema", "truth"]
