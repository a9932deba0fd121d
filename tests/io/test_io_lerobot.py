"""LeRobot datasets in both layouts, whole and incomplete."""

import json

import numpy as np
import pytest

from jaxest.io import lerobot, read
from jaxest.types import InputError

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

JOINTS = ["shoulder", "elbow"]
N, FPS = 6, 30


def column(values):
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def episode(index, n=N):
    rng = np.random.default_rng(index)
    return pa.table(
        {
            "observation.state": column(rng.normal(size=(n, 2)).astype(np.float32)),
            "action": pa.array(rng.normal(size=(n, 2)).astype(np.float32).tolist(), pa.list_(pa.float32())),
            "next.done": np.arange(n) == n - 1,
            "timestamp": (np.arange(n) / FPS).astype(np.float32),
            "frame_index": np.arange(n),
            "episode_index": np.full(n, index),
            "index": index * n + np.arange(n),
            "task_index": np.zeros(n, np.int64),
        }
    )


def make(root, version="v2.1", names=JOINTS, **info):
    features = {
        "observation.state": {"dtype": "float32", "shape": [2], "names": names},
        "action": {"dtype": "float32", "shape": [2], "names": names},
        "next.done": {"dtype": "bool", "shape": [1], "names": None},
        "observation.images.top": {"dtype": "video", "shape": [48, 64, 3], "names": None},
        **{k: {"dtype": "int64", "shape": [1]} for k in ("frame_index", "episode_index", "index", "task_index")},
        "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    }
    base = {"codebase_version": version, "fps": FPS, "total_episodes": 2, "total_frames": 2 * N, "features": features}
    (root / "meta").mkdir(parents=True)
    (root / "meta" / "info.json").write_text(json.dumps({**base, **info}))
    data = root / "data" / "chunk-000"
    data.mkdir(parents=True)
    if version.startswith("v2"):
        for i in range(2):
            parquet.write_table(episode(i), data / f"episode_{i:06d}.parquet")
    else:
        parquet.write_table(pa.concat_tables([episode(0), episode(1)]), data / "file-000.parquet")
    return root


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize("names", [JOINTS, {"motors": JOINTS}, {"shoulder": 0, "elbow": 1}])
def test_both_layouts(tmp_path, version, names):
    log = read(make(tmp_path / "set", version, names))
    assert set(log.streams) == {f"episode{i}/{k}" for i in (0, 1) for k in ("observation.state", "action", "next.done")}
    for i in (0, 1):
        item = log.streams[f"episode{i}/observation.state"]
        expected = np.random.default_rng(i).normal(size=(N, 2)).astype(np.float32)
        np.testing.assert_array_equal(item.value, expected)
        np.testing.assert_allclose(item.time, np.arange(N) / FPS, atol=1e-6)
        assert item.names == tuple(JOINTS)
    assert log.streams["episode1/next.done"].value.shape == (N,)
    assert any("video" in line for line in log.notes)
    assert any("30 frames" in line for line in log.notes)
    assert not any("incomplete" in line for line in log.notes)


def test_a_table_gives_a_unit(tmp_path):
    table = {"time": "episode1/action/time", "joint_position": {"array": "episode1/action/value", "unit": "deg"}}
    log = read(make(tmp_path / "set"), table)
    plain = lerobot.read(tmp_path / "set", episodes=[1])
    assert {name.split("/")[0] for name in plain.streams} == {"episode1"}
    found = log.streams["joint_position"].value
    np.testing.assert_allclose(found, np.deg2rad(plain.streams["episode1/action"].value), rtol=1e-6)


def test_an_episode_over_two_files(tmp_path):
    root = make(tmp_path / "set", "v3.0")
    whole = episode(0)
    data = root / "data" / "chunk-000"
    parquet.write_table(whole.slice(0, 4), data / "file-000.parquet")
    parquet.write_table(pa.concat_tables([whole.slice(4), episode(1)]), data / "file-001.parquet")
    assert len(read(root).streams["episode0/action"].time) == N


def test_incomplete_and_damaged(tmp_path):
    root = make(tmp_path / "set")
    file = root / "data" / "chunk-000" / "episode_000001.parquet"
    good = file.read_bytes()
    file.unlink()
    assert any("incomplete: 1 of the 2 episodes" in line for line in read(root).notes)
    with pytest.raises(InputError, match=r"no episode 1; it has 1, 0 to 0"):
        lerobot.read(root, episodes=[1])
    file.write_bytes(good[:-20])
    with pytest.raises(InputError, match=r"episode_000001\.parquet"):
        read(root)
    file.write_bytes(good)
    info = json.loads((root / "meta" / "info.json").read_text())
    info["features"]["action"]["shape"] = [3]
    (root / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match=r"action has 2 numbers a frame, info.json says \(3,\)"):
        read(root)
    info["features"]["gone"] = {"dtype": "float32", "shape": [3]}
    (root / "meta" / "info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match="column 'gone' is missing"):
        read(root)
    (root / "meta" / "info.json").write_text("{")
    with pytest.raises(InputError, match="not JSON"):
        read(root)
