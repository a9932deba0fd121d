"""Every file that is written is whole or not there, on a device that takes no more; what a run kept is read or told."""

import contextlib
import resource
from pathlib import Path

import numpy as np
import pytest

from jaxest import kinematics, models
from jaxest.calibration import imu
from jaxest.files import kept
from jaxest.io import SensorLog, Stream, chains, pieces, read, studies, write
from jaxest.io.checkpoint import save_state
from jaxest.io.clouds import Cloud, write_cloud
from jaxest.io.config import write_config
from jaxest.reproduce.iwao2025 import runs
from jaxest.reproduce.iwao2025.conditions import Condition
from jaxest.reproduce.santaera2015.kept import piece
from jaxest.simulate import proximity
from jaxest.types import InputError
from jaxest.viz import canvas, joints

ROOM = 256
"""Bytes that the device has left; every file of the test is larger."""


@contextlib.contextmanager
def nearly_full():
    """Let no file grow beyond `ROOM`: the system refuses the write then, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def log():
    time, value = np.arange(500) / 100, np.random.default_rng(0).normal(size=(500, 3))
    turned = np.tile([1.0, 0, 0, 0], (500, 1))
    streams = {"position": Stream(time, value, "m", "world"), "orientation": Stream(time, turned, "1", "world")}
    return SensorLog(streams)


def picture(path):
    time = np.arange(10.0)
    middle = np.zeros((10, 1))
    joints.draw(path, time, middle, middle - 1, middle + 1, names=["a"])


def calibration():
    eye, none = np.eye(3), np.zeros(3)
    one = imu.Calibration(**{name: eye if "matrix" in name else none for name in imu.Calibration._fields})
    return {f"imu{i}": one for i in range(5)}


def animated(path):
    from PIL import Image

    from jaxest.viz import animation

    noise = np.random.default_rng(0).integers(0, 255, (2, 48, 64, 3), np.uint8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(animation, "frames", lambda *given: iter(noise))
        patch.setattr(Image.Image, "quantize", lambda self, colours: self.convert("P"))
        animation.draw(path, "", np.zeros((2, 1)), overwrite=True)


ARM = models.path("arm")
WRITERS = {
    "log.npz": lambda path: write(log(), path, overwrite=True),
    "log.csv": lambda path: write(log(), path, overwrite=True),
    "log.parquet": lambda path: write(log(), path, overwrite=True),
    "log.h5": lambda path: write(log(), path, overwrite=True),
    "log.tum": lambda path: write(log(), path, overwrite=True),
    "state.npz": lambda path: save_state(path, np.zeros(1000), overwrite=True),
    "config.toml": lambda path: write_config(path, {"a": {"b": list(range(500))}}, overwrite=True),
    "cloud.ply": lambda path: write_cloud(Cloud(np.ones((99, 3)), np.ones(99)), path),
    "robot.xml": lambda path: kinematics.write(kinematics.load(ARM), path),
    "robot.urdf": lambda path: kinematics.write(kinematics.load(ARM), path),
    "imus.json": lambda path: imu.save(calibration(), path),
    "scan.npz": lambda path: proximity.save(proximity.Scan(np.arange(99.0), np.ones((99, 2)), np.ones((99, 4))), path),
    "joints.png": picture,
    "figure.png": lambda path: canvas.save(path, (2, 2), lambda figure: figure.subplots()),
    "arm.gif": animated,
}


@pytest.mark.parametrize("name", WRITERS)
def test_on_a_full_disk_the_file_before_stays_and_nothing_else(tmp_path, name):
    WRITERS[name](tmp_path / name)
    assert (tmp_path / name).stat().st_size > ROOM
    (tmp_path / name).write_text("precious")
    with nearly_full(), pytest.raises(InputError, match=r"cannot be written"):
        WRITERS[name](tmp_path / name)
    assert (tmp_path / name).read_text() == "precious"
    assert [p.name for p in tmp_path.iterdir()] == [name]


def study(folder):
    return studies.study(lambda x: 2 * x, np.arange(4, dtype=np.float32), piece=2, folder=folder)


def chain(folder):
    def advance(state, size):
        return state + np.int32(size), np.arange(size, dtype=np.int32)

    return chains.sample(advance, np.zeros((), np.int32), 4, piece=2, folder=folder)


def table(folder):
    """A row of the table without its estimator, which is not what is tested."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "estimated", lambda *given: None)
        patch.setattr(runs, "figures", lambda *given: {"mean": {"1": 0.1}})
        return runs.result("tiny", Condition("tiny", 1, 1, 1), runs.Plan(0, 0.3), folder)


KEPT = {
    "study": (study, "items*.npz"),
    "chain": (chain, "piece*.npz"),
    "santaera2015": (lambda folder: piece(folder, "one", lambda: {"x": np.arange(9)}), "santaera2015/one.npz"),
    "iwao2025, scans": (table, "scans/*.npz"),
    "iwao2025, runs": (table, "runs/*.json"),
}


@pytest.mark.parametrize("name", KEPT)
def test_pieces_of_other_code_are_told_and_not_used(tmp_path, name, monkeypatch):
    make, pattern = KEPT[name]
    folder = tmp_path / "kept"
    make(folder)
    make(folder)  # of this code: used
    before = {file: file.read_bytes() for file in folder.rglob("*") if file.is_file()}
    monkeypatch.setattr(pieces, "code", lambda parts=(): "jaxest 9.9, code 0123456789ab")
    if "scans" in name:  # figures are judged before the scans that they come from
        for file in folder.glob("runs/*"):
            before.pop(file)
            file.unlink()
    place = next(folder.glob(pattern)).parent
    with pytest.raises(InputError, match=rf"{place}: its pieces were made by jaxest .*, expected jaxest 9.9, .*delete"):
        make(folder)
    (place / pieces.RECORD).unlink()
    with pytest.raises(InputError, match=r"made by code that left no record"):
        make(folder)
    kept = {file: raw for file, raw in before.items() if file.name != pieces.RECORD}
    assert all(file.read_bytes() == raw for file, raw in kept.items())


def test_the_code_of_pieces_is_that_of_their_sources(tmp_path, monkeypatch):
    def package(text):
        for name, content in (("systems/a.py", text), ("metrics.py", "1"), ("cli/b.py", text), ("__init__.py", "")):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_text(content)
        pieces.code.cache_clear()
        return pieces.code(), pieces.code(("metrics",)), pieces.code(("metrics", "cli"))

    try:
        monkeypatch.setattr(pieces.jaxest, "__file__", str(tmp_path / "__init__.py"))
        one, other = package("x = 1"), package("x = 2")
    finally:
        pieces.code.cache_clear()
    assert [a == b for a, b in zip(one, other, strict=True)] == [False, True, False]


@pytest.mark.parametrize("spoil", [lambda raw: raw[: len(raw) // 2], lambda raw: b"", lambda raw: b"[]"])
@pytest.mark.parametrize("name", KEPT)
def test_a_kept_piece_that_cannot_be_read_is_told(tmp_path, name, spoil):
    make, pattern = KEPT[name]
    folder = tmp_path / "kept"
    make(folder)
    if "scans" in name:
        for file in folder.glob("runs/*.json"):
            file.unlink()
    file = next(iter(sorted(folder.glob(pattern))))
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises(InputError, match=rf"{file.name}: no run can go on from this file \(.*delete it"):
        make(folder)
    file.unlink()
    make(folder)


def test_an_absent_file_is_told_once():
    with pytest.raises(InputError) as caught, kept("no.npz"):
        read(Path("no.npz"))
    assert str(caught.value).count("no.npz") == 1
