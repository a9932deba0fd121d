"""The guess at other people's layouts."""

import tomllib

import numpy as np
import pytest

from jaxest.io import propose, read, to_toml
from jaxest.io.columns import parse
from jaxest.io.plausible import time_unit
from jaxest.io.words import classify
from jaxest.types import InputError

N = 400
RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("gyr", ("gyroscope", "", "", "")),
        ("angular_velocity", ("gyroscope", "", "", "")),
        ("field.angular_velocity.x", ("gyroscope", "", "x", "")),
        ("GyroX", ("gyroscope", "", "x", "")),
        ("gx", ("gyroscope", "", "x", "")),
        ("wz", ("gyroscope", "", "z", "")),
        ("imu0_gyr_y", ("gyroscope", "imu0", "y", "")),
        ("imu1/acc", ("accelerometer", "imu1", "", "")),
        ("acc_x (m/s^2)", ("accelerometer", "", "x", "m/s^2")),
        ("acc_g", ("accelerometer", "", "", "g")),
        ("gyro_dps", ("gyroscope", "", "", "deg/s")),
        ("mag x [uT]", ("magnetometer", "", "x", "uT")),
        ("gyro_x_dps", ("gyroscope", "", "x", "dps")),
        ("wrist_gyro_x_deg_s", ("gyroscope", "wrist", "x", "deg/s")),
        ("acc_x_m_s2", ("accelerometer", "", "x", "m/s2")),
        ("acc_x_g", ("accelerometer", "", "x", "g")),
        ("mag_x_uT", ("magnetometer", "", "x", "uT")),
        ("mag_y_mG", ("magnetometer", "", "y", "mG")),
        ("hook_z_mm", ("", "hook", "z", "mm")),
        ("max_g", ("", "max", "", "g")),
        ("enc_elbow", ("joint_position", "", "elbow", "")),
        ("encoder_3", ("joint_position", "", "3", "")),
        ("qw", ("orientation", "", "w", "")),
        ("q3", ("joint_position", "", "3", "")),
        ("right_j0", ("joint_position", "right", "0", "")),
        ("joint_2", ("joint_position", "", "2", "")),
        ("shoulder_pan_joint", ("joint_position", "", "shoulder_pan", "")),
        ("joint_2_temperature", ("", "temperature", "2", "")),
        ("joint", ("", "", "", "")),
        ("Quat_q0", ("orientation", "", "0", "")),
        ("imu_a_acc_x", ("accelerometer", "a", "x", "")),
        ("imu_w_gyr_y", ("gyroscope", "w", "y", "")),
        ("time_stamp [us]", ("time", "", "", "us")),
        ("Zeit (ms)", ("time", "", "", "ms")),
        ("us", ("time", "", "", "us")),
        ("time (h)", ("time", "", "", "h")),
        ("time (UTC)", ("time", "", "", "")),
        ("tau1 [kNm]", ("joint_torque", "", "1", "kNm")),
        ("q (-)", ("joint_position", "", "", "")),
        ("gyr[0]", ("gyroscope", "", "", "")),
        ("shoulder_pos [deg]", ("joint_position", "", "shoulder", "deg")),
        ("right_elbow_vel_rads", ("joint_velocity", "", "right_elbow", "rad/s")),
        ("tool_x [mm]", ("", "tool", "x", "mm")),
        ("joint_3_position", ("joint_position", "", "3", "")),
        ("dq_cmd", ("joint_velocity", "cmd", "", "")),
        ("target_positions", ("joint_position", "target", "", "")),
        ("timestamp_ns", ("time", "", "", "ns")),
        ("time_cmd", ("time", "cmd", "", "")),
        ("sampling_rate", ("rate", "", "", "")),
        ("a", ("", "a", "", "")),
        ("movement", ("", "movement", "", "")),
    ],
)
def test_names(name, meaning):
    assert classify(name) == meaning


def save(tmp_path, **arrays):
    np.savez(tmp_path / "log.npz", **arrays)
    return tmp_path / "log.npz"


def swinging(turns=3.0):
    """An IMU that rolls about x under gravity: stamps (s), gyroscope (rad/s), accelerometer (m/s2), quaternions."""
    time = np.arange(2000) / 100
    angle = turns * np.sin(2 * np.pi * 0.3 * time)
    rate = np.gradient(angle, time)
    gyr = np.stack([rate, 0 * rate, 0 * rate], 1)
    acc = 9.81 * np.stack([0 * angle, np.sin(angle), np.cos(angle)], 1)
    quat = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], 1)
    return time, gyr, acc, quat


def test_units_that_the_data_settle_are_applied_and_noted(tmp_path):
    time, gyr, acc, quat = swinging()
    field = np.tile([0.2, 0, -0.4], (len(time), 1))
    path = save(
        tmp_path, t=time * 1e6 + 1.7e15, gyro=np.rad2deg(gyr), acc=acc / 9.80665, mag=field, quat=quat[:, [1, 2, 3, 0]],
    )  # fmt: skip
    log = read(path)
    np.testing.assert_allclose(log.streams["gyroscope"].value, gyr)
    np.testing.assert_allclose(log.streams["accelerometer"].value, acc)
    np.testing.assert_allclose(log.streams["magnetometer"].value[0], [2e-5, 0, -4e-5])
    np.testing.assert_allclose(log.streams["orientation"].value, quat)
    np.testing.assert_allclose(log.streams["gyroscope"].time, 1.7e9 + time, atol=1e-6)
    notes = " ".join(log.notes)
    for word in ("deg/s", "unit g ", "unit G ", "xyzw", "'t' taken as us"):
        assert word in notes


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"gyr": np.zeros((N, 3))}, ["no sampling rate", "rate = "]),
        ({"gyr": np.zeros((N, 3)), "fs": 1.0, "rate": 2.0}, ["sampling rate could be any of fs, rate"]),
        ({"gyr": np.zeros((N, 3)), "t": np.arange(N) * 10}, ["unit of its stamps 't' is open"]),
        ({"gyr": np.zeros((N, 3)), "t_a": np.arange(N), "t_b": np.arange(N)}, ["stamps could be any of t_a, t_b"]),
        ({"gyr": np.zeros((N, 3)), "gyro": np.ones((N, 3)), "fs": 1.0}, ["gyroscope", "gyr", "gyro", "could be it"]),
        ({"acc": np.full((N, 3), 100.0), "fs": 1.0}, ["173.2", "neither m/s2 nor g"]),
        ({"gyr": np.full((N, 3), 100.0), "fs": 1.0}, ["faster than any gyroscope", 'unit = "deg/s"']),
        ({"acc": np.full((N, 3), np.nan), "fs": 1.0}, ["accelerometer: no row of it is finite"]),
        ({"gyr": np.zeros((3, N)), "acc": np.full((N, 3), 5.7), "fs": 1.0}, ["(3, 400)", "(n, 3)"]),
    ],
)
def test_what_is_open_is_asked_with_lines_to_paste(tmp_path, arrays, words):
    path = save(tmp_path, **arrays)
    with pytest.raises(InputError) as error:
        read(path)
    for word in ["log.npz", "[columns]", *words]:
        assert word in str(error.value)
    guess = propose(path)
    assert guess.unsure
    assert parse(tomllib.loads(to_toml(guess))["columns"]) == guess.table


@pytest.mark.parametrize(("step", "unit"), [(10, "ms"), (2500, "us"), (10_000_000, "ns")])
def test_the_likely_unit_of_stamps_is_proposed(tmp_path, step, unit):
    guess = propose(save(tmp_path, gyr=np.zeros((N, 3)), t=np.arange(N) * step))
    assert guess.table.time_unit == unit
    assert f"is open (median step {step:g}); {unit} is likely" in guess.unsure[0]


@pytest.mark.parametrize(
    ("start", "step", "unit"),
    [
        (600_000_000_000, 10_000, ""),  # us, up for a week
        (600_000_000, 10_000, ""),  # us, up for ten minutes
        (1_700_000_000_000, 10_000_000, ""),  # ns, up for half an hour
        (1_700_000_000_000, 10, "ms"),
        (1_700_000_000_000, 1040, "ms"),  # 1 Hz
        (1_700_000_000_000_000_000, 10_000_000_000, "ns"),  # 0.1 Hz; there is nothing finer
        (1_700_000_000, 1, "s"),
    ],
)
def test_stamps_since_1970_have_a_step_that_fits(start, step, unit):
    assert time_unit(start + step * np.arange(20)) == unit


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("time [s],q1 [deg],q2 [rad]", "unit of q1 [deg], q2 [rad] is 'deg, rad', expected one known unit"),
        ("time [s],q1 [deg],q2", "unit of q1 [deg], q2 is 'deg, none'"),
        ("time [s],q1 [ticks],q2 [ticks]", "unit of q1 [ticks], q2 [ticks] is 'ticks'"),
        ("time [s],tau1 [mNm],tau2 [kNm]", "'mNm, kNm', expected one known unit, such as 'Nm'"),
        ("time [0.1ms],q1,q2", "unit of its stamps 'time [0.1ms]' is '0.1ms', expected s, ms, us or ns"),
        ("time (h),q1 [-],q2 [-]", "unit of its stamps 'time (h)' is 'h'"),
    ],
)
def test_a_unit_that_is_stated_is_never_another_one(tmp_path, names, message):
    rows = [f"{0.01 * i},10,{0.1 * i}" for i in range(20)]
    (tmp_path / "log.csv").write_text("\n".join([names, *rows]))
    with pytest.raises(InputError) as error:
        read(tmp_path / "log.csv")
    assert message in str(error.value)
    with pytest.raises(InputError, match="unit"):  # nor where nobody changes the lines that are proposed
        read(tmp_path / "log.csv", tomllib.loads(to_toml(propose(tmp_path / "log.csv")))["columns"])


def test_counts_of_an_imu_and_a_period_in_other_units_are_asked(tmp_path):
    arrays = {"gyr [LSB]": np.zeros((N, 3)), "acc": np.tile([0, 0, 9.81], (N, 1)), "dt [ms]": 10.0}
    found = propose(save(tmp_path, **arrays))
    assert "gyroscope: the unit of gyr [LSB] is 'LSB', expected one known unit, such as 'rad/s'" in found.unsure
    assert "gyroscope: the unit of dt [ms] is not Hz or s; add rate = ... in Hz" in found.unsure


def test_the_pasted_lines_read_the_file(tmp_path):
    path = save(tmp_path, gyr=np.zeros((N, 3), np.float32), fs=1.0, rate=2.0)
    table = tomllib.loads(to_toml(propose(path)))["columns"]
    assert read(path, table).streams["gyroscope"].value.dtype == np.float32


def test_columns_of_a_csv_are_grouped(tmp_path):
    head = "time_ms,imu0_gx,imu0_gy,imu0_gz,imu1_gx,imu1_gy,imu1_gz,qw,qx,qy,qz,q1,q2,temperature"
    rows = [f"{k * 10}," + ",".join(["0.1"] * 6 + ["1", "0", "0", "0", "0.3", "0.4", "20"]) for k in range(9)]
    (tmp_path / "log.csv").write_text("\n".join([head, *rows]))
    log = read(tmp_path / "log.csv")
    shapes = {name: stream.value.shape for name, stream in log.streams.items()}
    assert shapes == {
        "imu0/gyroscope": (9, 3), "imu1/gyroscope": (9, 3), "orientation": (9, 4), "joint_position": (9, 2),
        "temperature": (9,),
    }  # fmt: skip
    np.testing.assert_array_equal(log.streams["orientation"].value[0], [1, 0, 0, 0])
    np.testing.assert_allclose(log.streams["orientation"].time, np.arange(9) / 100)
    assert log.streams["joint_position"].names == ("q1", "q2")


def test_quaternions_called_q_and_four_joints_called_q(tmp_path):
    quat = RNG.normal(size=(N, 4))
    unit = quat / np.linalg.norm(quat, axis=1, keepdims=True)
    assert "orientation" in read(save(tmp_path, q=unit, fs=10.0)).streams
    assert "joint_position" in read(save(tmp_path, q=quat, fs=10.0)).streams


def test_a_period_becomes_a_rate_and_leftovers_are_named(tmp_path):
    log = read(save(tmp_path, gyr=np.zeros((N, 3)), dt=0.02, odd=np.zeros(7)))
    np.testing.assert_allclose(log.streams["gyroscope"].time, np.arange(N) * 0.02)
    assert "left out: odd" in log.notes


def test_nothing_to_read(tmp_path):
    with pytest.raises(InputError, match=r"nothing here looks like a stream; arrays: a \(3,\)"):
        read(save(tmp_path, a=np.zeros(3)))


@pytest.mark.parametrize(
    ("names", "stream"),
    [
        (["arm_j0", "arm_j1", "arm_j10"], "arm/joint_position"),
        (["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"], "joint_position"),
    ],
)
def test_columns_that_are_called_as_joints_are_one_stream_in_their_order(tmp_path, names, stream):
    value = RNG.normal(size=(N, 3))
    rows = np.c_[np.arange(N) / 10, value].tolist()
    lines = [["time", *names], *([repr(x) for x in row] for row in rows)]
    (tmp_path / "log.csv").write_text("\n".join(",".join(line) for line in lines))
    found = read(tmp_path / "log.csv").streams[stream]
    assert found.names == tuple(names)
    np.testing.assert_array_equal(found.value, value)


def test_joints_by_their_names_and_a_point_in_millimetres(tmp_path):
    """As a lab writes them: a column for each joint in degrees, and the tool's place in mm."""
    time, angles, tool = np.arange(N) / 10, RNG.normal(size=(N, 2)) * 50, RNG.normal(size=(N, 3)) * 100
    names = ["t_ms", "yaw_pos [deg]", "elbow_pos [deg]", "tool_x [mm]", "tool_y [mm]", "tool_z [mm]"]
    rows = np.c_[1e3 * time, angles, tool].tolist()
    (tmp_path / "log.csv").write_text("\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows)]))
    found = read(tmp_path / "log.csv").streams
    assert found["joint_position"].names == ("yaw", "elbow")
    np.testing.assert_allclose(found["joint_position"].value, np.deg2rad(angles))
    assert found["tool/position"].unit == "m"
    np.testing.assert_allclose(found["tool/position"].value, 1e-3 * tool)
    euler = [f"{part}_angle [deg]" for part in ("roll", "pitch", "yaw")]  # of an IMU: three joints they are not
    rows = np.c_[time, tool].tolist()
    (tmp_path / "imu.csv").write_text("\n".join([",".join(["t", *euler]), *(",".join(map(repr, row)) for row in rows)]))
    assert list(read(tmp_path / "imu.csv").streams) == euler


def test_columns_called_by_joints_and_a_unit_of_angles_are_joints(tmp_path):
    time, angles = np.arange(N) / 10, RNG.normal(size=(N, 2)) * 50
    for names, stream in (
        (["lift_deg", "knee_deg"], "joint_position"),
        (["latitude_deg", "longitude_deg"], None),
        (["roll_deg", "pitch_deg"], None),
        (["lift_deg", "knee_rad"], None),
    ):
        rows = [",".join(map(repr, row)) for row in np.c_[time, angles].tolist()]
        (tmp_path / "log.csv").write_text("\n".join([",".join(["t", *names]), *rows]))
        log = read(tmp_path / "log.csv")
        assert list(log.streams) == ([stream] if stream else names)
        if stream:
            assert log.streams[stream].names == ("lift", "knee")
            np.testing.assert_allclose(log.streams[stream].value, np.deg2rad(angles))
            assert any("lift_deg, knee_deg taken for angles of joints" in note for note in log.notes)


def test_a_gyroscope_whose_motion_does_not_tell_its_unit_has_that_of_the_others(tmp_path):
    time, gyr, acc, _ = swinging()
    upright, turning = np.tile([0, 0, 9.80665], (len(time), 1)), np.tile([0, 0, 20.0], (len(time), 1))
    arrays = {"mast_gyr": turning, "mast_acc": upright, "boom_gyr": np.rad2deg(gyr), "boom_acc": acc}
    found = propose(save(tmp_path, t=time, **arrays))
    assert found.table.streams["mast/gyroscope"].unit == found.table.streams["boom/gyroscope"].unit == "deg/s"
    assert any("mast/gyroscope: its motion does not tell" in line for line in found.assumed)
    found = propose(save(tmp_path, t=time, **arrays | {"boom_gyr": gyr}))
    assert found.table.streams["mast/gyroscope"].unit == "rad/s"


def test_joints_in_degrees_and_matrices_of_rows_for_axes_are_asked(tmp_path):
    wide = {"fs": 100.0, "Gyr": RNG.normal(size=(3, 400)), "Acc": np.tile([[0.0], [0.0], [9.8]], 400)}
    found = propose(save(tmp_path, **wide))
    assert found.table.streams["accelerometer"].transposed
    assert "Acc (3, 400): seems transposed, expected (n, 3)" in found.unsure
    found = propose(save(tmp_path, t=np.arange(N) / 10, q=np.linspace(0, 100, 3 * N).reshape(N, 3)))
    assert found.table.streams["joint_position"].unit == "deg"
    assert any("up to 100, in rad more than two turns, so probably in deg" in line for line in found.unsure)
