"""Point clouds there and back, other people's headers, and what is wrong with a file."""

import numpy as np
import pytest

from jaxest.io.clouds import Cloud, read_cloud, write_cloud
from jaxest.types import InputError

CLOUD = Cloud(np.random.default_rng(0).normal(size=(50, 3)), np.arange(1.0, 51.0))


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz"])
def test_there_and_back(tmp_path, suffix):
    path = tmp_path / f"map{suffix}"
    write_cloud(CLOUD, path)
    found = read_cloud(path)
    np.testing.assert_allclose(found.point, CLOUD.point, atol=0 if suffix == ".npz" else 3e-7)
    np.testing.assert_array_equal(found.count, CLOUD.count)
    write_cloud(Cloud(np.zeros((0, 3)), np.zeros(0)), path)
    assert read_cloud(path).point.shape == (0, 3)


def test_other_peoples_files(tmp_path):
    text = (
        "ply\nformat ascii 1.0\ncomment hello\nelement vertex 2\nproperty double x\nproperty double y\n"
        "property double z\nproperty uchar red\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
        "1 2 3 255\nnan 5 6 0\n"
    )
    (tmp_path / "a.ply").write_text(text)
    found = read_cloud(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.point, [[1, 2, 3]])
    np.testing.assert_array_equal(found.count, [1])
    big = np.array([(1, 2, 3)], dtype=[(n, ">f4") for n in "xyz"])
    head = text.split("comment")[0].replace("ascii", "binary_big_endian") + "element vertex 1\n"
    head += "".join(f"property float {n}\n" for n in "xyz") + "end_header\n"
    (tmp_path / "b.ply").write_bytes(head.encode() + big.tobytes())
    np.testing.assert_array_equal(read_cloud(tmp_path / "b.ply").point, [[1, 2, 3]])
    pcd = (
        "# .PCD v.7\nVERSION .7\nFIELDS x y z normal\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 3\nWIDTH 1\nHEIGHT 1\n"
        "POINTS 1\nDATA binary\n"
    )
    (tmp_path / "c.pcd").write_bytes(pcd.encode() + np.array([4, 5, 6, 0, 0, 1], "<f4").tobytes())
    np.testing.assert_array_equal(read_cloud(tmp_path / "c.pcd").point, [[4, 5, 6]])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"plx\n", "is no PLY file"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "has no field y, z"),
        ("a.ply", b"ply\nformat zip 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "format 'zip'"),
        ("a.pcd", b"hello", "has no line DATA"),
        ("a.pcd", b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 9\nDATA binary\n", "0 bytes of points, expected 108"),
        (
            "a.pcd",
            b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 2\nDATA ascii\n1 2 3\n",
            "1 rows of points, expected 2",
        ),
        ("a.pcd", b"FIELDS x y z\nPOINTS 2\nDATA ascii\n1 2 3\n", "header without"),
        ("a.npz", b"no", "expected a zip of .npy"),
        ("a.xyz", b"", "ends in '.xyz', expected one of .ply, .pcd, .npz"),
    ],
)
def test_what_is_no_cloud_is_told(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message.replace(".", r"\.")):
        read_cloud(tmp_path / name)


def test_counts_belong_to_points(tmp_path):
    with pytest.raises(InputError, match="counts for 50 points"):
        write_cloud(Cloud(CLOUD.point, np.ones(3)), tmp_path / "a.ply")
