"""Files of every kind, broken in random ways: a result or an `InputError`, never another exception, crash or hang.

24 cases for each of 21 kinds run here (504), and 1500 for each (31,500) with `-m slow`; seeds are fixed. Warnings are
errors, as everywhere in these tests.
"""

import time
import zipfile

import numpy as np
import pytest
from broken_files import KINDS, broken

from jaxest.io import read
from jaxest.kinematics import load
from jaxest.types import InputError

FEW, MANY = 24, 1500
HANG = 30  # s; what a hang is, no claim about speed


def outcomes(name, folder, seeds):
    """Whether each broken file gave a result; of a folder, one file of it is broken."""
    kind = KINDS[name]
    path = folder / f"log{kind.suffix}"
    kind.make(path)
    kind.use(path)
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    good = {file: file.read_bytes() for file in files}
    found = []
    for seed in seeds:
        random = np.random.default_rng(seed)
        file = files[random.integers(len(files))]
        file.write_bytes(broken(good[file], random))
        begun = time.perf_counter()
        try:
            kind.use(path)
            found.append(True)
        except InputError as error:
            assert str(path) in str(error), f"case {seed}: the message names no file: {error}"
            found.append(False)
        except Exception as error:
            raise AssertionError(f"case {seed}: {error!r}") from error
        assert time.perf_counter() - begun < HANG, f"case {seed} took too long"
        file.write_bytes(good[file])
    return found


@pytest.mark.parametrize("name", KINDS)
def test_a_broken_file_is_read_or_refused(name, tmp_path):
    found = outcomes(name, tmp_path, range(FEW))
    assert len(found) == FEW
    assert name == "lines" or not all(found)  # lines are refused one by one


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_many_broken_files(name, tmp_path):
    assert len(outcomes(name, tmp_path, range(FEW, FEW + MANY))) == MANY


def test_an_archive_that_grows_without_end_is_refused(tmp_path):
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("gyroscope/time.npy", b"\x93NUMPY\x01\x00v\x00" + b"0" * 10_000_000)
    with pytest.raises(InputError, match=r"bomb\.npz"):
        read(path)


def test_members_of_an_archive_stay_inside_it(tmp_path):
    """A name that climbs out of the folder is a name like any other: nothing is unpacked."""
    path = tmp_path / "inner" / "climb.npz"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../../outside.npy", b"no array")
    with pytest.raises(InputError, match=r"climb\.npz"):
        read(path)
    assert not list(tmp_path.rglob("outside*"))


@pytest.mark.parametrize(
    "head",
    [
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa">' + "".join(
            f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
        ) + "]>",
    ],
    ids=["external", "laughs"],
)  # fmt: skip
def test_entities_of_xml_are_not_followed(tmp_path, head):
    path = tmp_path / "arm.urdf"
    name = "&x;" if "SYSTEM" in head else "&i;"
    path.write_text(f'<?xml version="1.0"?>{head}<robot name="arm"><link name="{name}"/></robot>')
    with pytest.raises(InputError, match=r"arm\.urdf"):
        load(path)


def test_an_include_that_is_not_there_is_named(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text('<mujoco><include file="../../nowhere/secret.xml"/></mujoco>')
    with pytest.raises(InputError, match=r"secret\.xml"):
        load(path)
