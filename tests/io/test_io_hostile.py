"""Files made to hurt: they claim gigabytes, nest without end, wait for ever, or point out of their folder."""

import bz2
import os
import struct
import zipfile

import numpy as np
import pytest
from broken_files import TABLE, ros1

from jaxest.io import bags, config, hdf5, lerobot, read
from jaxest.io.growth import LARGE, RATIO, excessive
from jaxest.kinematics import load
from jaxest.kinematics.includes import MOST
from jaxest.types import InputError, listed

DEEP = "[" * 100_000 + "]" * 100_000
ZEROS = LARGE // 8 + 1  # float64s of more than is allowed
PART = "<mujoco><worldbody><body name='part'><joint/><geom size='.1'/></body></worldbody></mujoco>"


def test_much_is_excessive_only_beside_little():
    assert not excessive(LARGE, 1)
    assert not excessive(RATIO * LARGE, LARGE)
    assert excessive(RATIO * LARGE + 1, LARGE)


def npz_of_many(path):
    """Members that say, in the archive's directory, that each has half of what is allowed."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in "abc":
            archive.writestr(f"{name}.npy", bytes(1000))
        for info in archive.filelist:
            info.file_size = LARGE // 2


def npz_of_depth(path):
    with zipfile.ZipFile(path, "w") as archive:
        for name, value in (("time", np.arange(3.0)), ("value", np.zeros(3)), ("meta", np.array(DEEP))):
            with archive.open(f"gyroscope/{name}.npy", "w") as file:
                np.lib.format.write_array(file, value)


def hdf5_of_holes(path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name in ("gyroscope/time", "gyroscope/value"):
            file.create_dataset(name, shape=(ZEROS,), dtype="f8", chunks=(1000,))


def parquet_of_runs(path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    column = arrow.nulls(ZEROS // 5 + 1, arrow.int8())
    parquet.write_table(arrow.table({f"c{i}": column for i in range(5)}), path, row_group_size=len(column))


def bag_that_grows(path):
    """A chunk that says, truly, that it unpacks to more than is allowed."""
    ros1(path)
    data = path.read_bytes()
    at = data.index(b"size=") + 5
    path.write_bytes(data[:at] + struct.pack("<I", 2**32 - 1) + data[at + 4 :])


def mcap_that_grows(path):
    chunk = struct.pack("<QQQI", 0, 1, 2**40, 0) + struct.pack("<I", 3) + b"bz2" + bz2.compress(bytes(1000))
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(chunk)) + chunk)


def dataset_of_depth(path):
    (path / "meta").mkdir(parents=True)
    (path / "meta" / "info.json").write_text(DEEP)


def pipe(path):
    os.mkfifo(path)


def endless(path):
    path.symlink_to("/dev/zero")


def text(content):
    return lambda path: path.write_text(content)


@pytest.mark.parametrize(
    ("name", "make", "use", "words"),
    [
        ("many.npz", npz_of_many, read, "claims"),
        ("deep.npz", npz_of_depth, read, "is not JSON"),
        ("holes.h5", hdf5_of_holes, read, "claims"),
        ("runs.parquet", parquet_of_runs, read, "claims"),
        ("grows.bag", bag_that_grows, read, "claims"),
        ("grows.mcap", mcap_that_grows, read, "claims"),
        ("deep", dataset_of_depth, lerobot.read, "is not JSON"),
        ("deep.csv", text(f"# jaxest-log {DEEP}\ntime\n1\n"), read, "is not JSON"),
        ("wide.csv", text("," * 50_000 + "\n" + "1," * 50_000), lambda path: read(path, TABLE), "does not exist"),
        ("quote.csv", text('stamp_ms,gyr_x\n0,"' + "x" * 5_000_000), read, "larger than field limit"),
        ("deep.toml", text(f"a = {DEEP}"), config.read_config, "not valid TOML"),
        ("deep.xml", text("<mujoco>" + "<body>" * 100_000), load, "nesting"),
        ("deep.urdf", text("<robot name='a'>" + "<link>" * 50_000 + "</link>" * 50_000 + "</robot>"), load, "nesting"),
        ("copies.xml", text("<mujoco><worldbody><replicate count='1000000'/></worldbody></mujoco>"), load, "copies"),
        ("self.xml", text("<mujoco><include file='self.xml'/></mujoco>"), load, "already included"),
        ("device.xml", text("<mujoco><include file='/dev/zero'/></mujoco>"), load, "is no file"),
        ("words.xml", text("<mujoco><include file='/etc/passwd'/></mujoco>"), load, "Include error"),
        ("pipe.csv", pipe, read, "pipe or a device"),
        ("endless.csv", endless, read, "pipe or a device"),
    ],
)
def test_it_is_refused_by_name_and_soon(tmp_path, name, make, use, words):
    path = tmp_path / name
    make(path)
    with pytest.raises(InputError) as caught:
        use(path)
    assert words in str(caught.value)
    assert name in str(caught.value)
    assert len(str(caught.value)) < 3000


def test_copies_multiply_where_they_are_nested(tmp_path):
    inner = "<replicate count='500'><geom size='.1'/></replicate>"
    text = f"<mujoco><worldbody><replicate count='{MOST // 500 + 1}'>{inner}</replicate></worldbody></mujoco>"
    with pytest.raises(InputError, match="copies"):
        load(text)
    assert load(f"<mujoco><worldbody><body><joint/>{inner}</body></worldbody></mujoco>").nq == 1


def test_what_is_read_from_outside_a_robots_folder_is_said(tmp_path):
    (tmp_path / "part.xml").write_text(PART)
    (tmp_path / "robot").mkdir()
    path = tmp_path / "robot" / "arm.xml"
    path.write_text("<mujoco><include file='../part.xml'/></mujoco>")
    robot = load(path)
    assert robot.nq == 1
    assert any("../part.xml from outside" in note for note in robot.notes)
    (tmp_path / "robot" / "part.xml").write_text(PART)
    path.write_text("<mujoco><include file='part.xml'/></mujoco>")
    assert not load(path).notes


def test_numbers_in_other_files_are_not_followed(tmp_path):
    h5py = pytest.importorskip("h5py")
    secret = tmp_path / "secret.bin"
    secret.write_bytes(bytes(range(240)))
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["time"] = np.arange(3.0)
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["imu/time"], file["imu/value"] = np.arange(3.0), np.zeros((3, 3))
        file["imu/loop"] = h5py.SoftLink("/imu")
        file["link"] = h5py.ExternalLink("other.h5", "/time")
        file.create_dataset("raw", shape=(30,), dtype="f8", external=[(str(secret), 0, 240)])
        layout = h5py.VirtualLayout(shape=(3,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "time", shape=(3,))
        file.create_virtual_dataset("virtual", layout)
    found = hdf5.load(tmp_path / "log.h5")
    assert set(found.arrays) == {"imu/time", "imu/value"}
    assert set(found.refused) == {"raw", "virtual"}


def test_a_bag_reads_nothing_beside_its_folder(tmp_path):
    pytest.importorskip("rosbags")
    from broken_files import ros2

    ros2(tmp_path / "outside")
    ros2(tmp_path / "bag")
    (store,) = (tmp_path / "bag").glob("*.db3")
    store.unlink()
    meta = tmp_path / "bag" / "metadata.yaml"
    meta.write_text(meta.read_text().replace(store.name, "../outside/outside.db3"))
    with pytest.raises(InputError, match="bag"):
        bags.read(tmp_path / "bag")


def test_a_message_type_that_never_ends_is_refused(tmp_path):
    """A bag brings its own definitions: one that holds itself, and a sequence of parts without a byte."""
    pytest.importorskip("rosbags")
    from jaxest.io.bag_layout import layout

    sequence = {"a/msg/A": ((), (("x", (4, ((2, "a/msg/B"), 0))),)), "a/msg/B": ((), ())}
    with pytest.raises(ValueError, match="claims"):
        layout(b"\0\1\0\0" + struct.pack("<I", 2**32 - 1), "a/msg/A", sequence, True)


def test_pickles_are_never_read(tmp_path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "hacked"),)

    for name, use in (("log.npz", read), ("points.npz", None)):
        path = tmp_path / name
        np.savez(path, point=np.array([Evil()], object), **{"gyroscope/time": np.arange(3.0)})
        with pytest.raises(InputError):
            if use:
                use(path)
            else:
                from jaxest.io.clouds import read_cloud

                read_cloud(path)
    assert not (tmp_path / "hacked").exists()


def test_messages_name_the_first_few_of_many():
    assert listed("ab") == "a, b"
    assert listed(()) == "none"
    assert listed(map(str, range(30)), most=2) == "0, 1 and 28 more"


def test_json_of_a_calibration_and_a_checkpoint_may_nest_as_it_likes(tmp_path):
    from jaxest.calibration import imu
    from jaxest.io import load_state

    (tmp_path / "a.json").write_text(DEEP)
    with pytest.raises(InputError, match="not a calibration"):
        imu.load(tmp_path / "a.json")
    np.savez(tmp_path / "a.npz", checkpoint=np.array(DEEP))
    with pytest.raises(InputError, match="header is damaged"):
        load_state(tmp_path / "a.npz", 1.0)
