"""What each ROS message type means as streams."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io.bag_layout import Layout, values
from jaxest.types import InputError

Block = NDArray[np.uint8]


class Part(NamedTuple):
    """Samples of one quantity."""

    name: str
    """Stream name behind the topic; empty for the topic itself."""
    unit: str
    value: NDArray[Any] | list[NDArray[Any]]
    """(n, ...), or for point clouds a list of (points, 3)."""
    there: NDArray[np.bool_]
    """(n,) which messages have a sample of it."""


def _vector(block: Block, item: Layout, path: str, axes: str = "xyz") -> NDArray[Any]:
    return np.stack([values(block, item, f"{path}.{axis}") for axis in axes], axis=-1)


def _all(block: Block) -> NDArray[np.bool_]:
    return np.ones(len(block), bool)


def _imu(block: Block, item: Layout) -> list[Part]:
    parts = []
    for path, name, unit, axes in (
        ("angular_velocity", "gyroscope", "rad/s", "xyz"),
        ("linear_acceleration", "accelerometer", "m/s2", "xyz"),
        ("orientation", "orientation", "1", "wxyz"),
    ):
        # By sensor_msgs/Imu's own rule, a first covariance of -1 says that the message has no such reading.
        there = values(block, item, f"{path}_covariance")[:, 0] != -1
        value = _vector(block, item, path, axes)
        if name == "orientation":
            there &= value.any(axis=1)  # a quaternion of zeros is one that nobody filled in
        parts.append(Part(name, unit, value, there))
    return parts


def _magnetic(block: Block, item: Layout) -> list[Part]:
    return [Part("magnetometer", "T", _vector(block, item, "magnetic_field"), _all(block))]


def _pose(block: Block, item: Layout) -> list[Part]:
    position, orientation = _vector(block, item, "pose.position"), _vector(block, item, "pose.orientation", "wxyz")
    return [Part("position", "m", position, _all(block)), Part("orientation", "1", orientation, _all(block))]


def _point(block: Block, item: Layout) -> list[Part]:
    return [Part("position", "m", _vector(block, item, "point"), _all(block))]


def _quaternion(block: Block, item: Layout) -> list[Part]:
    return [Part("orientation", "1", _vector(block, item, "quaternion", "wxyz"), _all(block))]


def _joints(block: Block, item: Layout) -> list[Part]:
    parts = []
    for path, name, unit in (
        ("position", "joint_position", "rad"),
        ("velocity", "joint_velocity", "rad/s"),
        ("effort", "joint_torque", "Nm"),
    ):
        value = values(block, item, path)
        if value.shape[1]:  # an empty sequence says that the message has no such readings
            parts.append(Part(name, unit, value, _all(block)))
    return parts


def _cloud(block: Block, item: Layout) -> list[Part]:
    """Points of each cloud, whatever else it has for each point."""
    paths = {text: path.removesuffix("name") for path, text in item.texts.items() if path.startswith("fields.")}
    if not {"x", "y", "z"} <= set(paths):
        raise InputError(f"the cloud has fields {', '.join(paths) or 'none'}, expected x, y and z")
    number = {7: "f4", 8: "f8"}
    heads = {p: values(block, item, p) for p in ("height", "width", "is_bigendian", "point_step", "row_step")}
    of = {axis: [values(block, item, paths[axis] + p) for p in ("offset", "datatype")] for axis in "xyz"}
    data, clouds = values(block, item, "data"), []
    for i in range(len(block)):
        height, width, big, step, row = (int(heads[p][i]) for p in heads)
        codes = {int(of[axis][1][i]) for axis in "xyz"}
        if len(codes) != 1 or not codes <= set(number):
            raise InputError(f"x, y, z are of datatypes {sorted(codes)}, expected all 7 (float32) or all 8 (float64)")
        code = (">" if big else "<") + number[codes.pop()]
        places = [int(of[axis][0][i]) for axis in "xyz"]
        size, room = np.dtype(code).itemsize, max(step, row)
        if height * width and (max(places) + size > step or width * step > row or (height - 1) * room + width * step
                               > data.shape[1]):  # fmt: skip
            raise InputError(f"{height} x {width} points of {step} bytes do not fit in {data.shape[1]} bytes")
        kind = np.dtype({"names": list("xyz"), "formats": [code] * 3, "offsets": places, "itemsize": max(step, 1)})
        points = np.ndarray((height, width), kind, np.ascontiguousarray(data[i]), 0, (row, step))
        clouds.append(np.stack([points[axis].ravel() for axis in "xyz"], axis=-1).astype(number[7] if size == 4
                      else number[8]))  # fmt: skip
    return [Part("points", "m", clouds, _all(block))]


def _numbers(block: Block, item: Layout) -> list[Part]:
    value = values(block, item, "data")
    sizes = [p for p in item.fields if p.startswith("layout.dim.") and p.endswith(".size")]
    shape = tuple(int(values(block[:1], item, p)[0]) for p in sizes)
    if int(np.prod(shape)) != value.shape[1]:  # many publishers leave the layout empty
        shape = value.shape[1:]
    return [Part("", "", value.reshape(len(block), *shape), _all(block))]


TYPES: dict[str, Callable[[Block, Layout], list[Part]]] = {
    "sensor_msgs/msg/Imu": _imu,
    "sensor_msgs/msg/MagneticField": _magnetic,
    "sensor_msgs/msg/JointState": _joints,
    "sensor_msgs/msg/PointCloud2": _cloud,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PointStamped": _point,
    "geometry_msgs/msg/QuaternionStamped": _quaternion,
    "std_msgs/msg/Float64MultiArray": _numbers,
}
"""The types that are read; others are listed in the log's notes."""


def names_of(item: Layout) -> tuple[str, ...]:
    """Return the joint names of a message, in its order."""
    return tuple(text for path, text in item.texts.items() if path.startswith("name."))
