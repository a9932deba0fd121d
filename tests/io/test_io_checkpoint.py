"""Checkpoints: any state pytree, bit for bit; validated on load; never a pickle."""

import dataclasses
import json
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxest.io import load_state, save_state
from jaxest.types import InputError


class Inner(NamedTuple):
    mean: jax.Array
    extra: dict | None


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Outer:
    inner: Inner
    counts: tuple


def blank(dtype):
    return Outer(
        Inner(jnp.zeros(3, dtype), {"a": None, "b/c": jnp.ones((0, 3), dtype)}),
        (jnp.int32(0), np.zeros(2, bool), 0, 0.0, False),
    )


def state(dtype=jnp.float32):
    return Outer(
        Inner(jnp.array([1.5, -0.0, jnp.nan], dtype), {"a": None, "b/c": jnp.zeros((0, 3), dtype)}),
        (jnp.int32(7), np.array([True, False]), 3, 2.5, True),
    )


def bits(tree):
    leaves, structure = jax.tree_util.tree_flatten(tree)
    return structure, [(type(x), np.asarray(x).dtype, np.shape(x), np.asarray(x).tobytes()) for x in leaves]


def test_round_trip_is_bitwise(tmp_path, dtype):
    save_state(tmp_path / "state.npz", state(dtype))
    back = load_state(tmp_path / "state.npz", like=blank(dtype))
    assert bits(back) == bits(state(dtype))


def test_other_dtypes_and_a_bare_leaf(tmp_path):
    for i, leaf in enumerate([
        jnp.arange(5, dtype=jnp.bfloat16), jnp.array(3, jnp.bfloat16), jnp.array([1 + 2j]), np.float64(0.1),
        np.arange(6.0).reshape(2, 3).T, jnp.uint8(200),
    ]):  # fmt: skip
        save_state(tmp_path / f"{i}.npz", leaf)
        back = load_state(tmp_path / f"{i}.npz", leaf)
        assert back.dtype == leaf.dtype
        np.testing.assert_array_equal(np.asarray(back), np.asarray(leaf))


@pytest.mark.parametrize("impl", ["threefry2x32", "rbg"])
def test_typed_keys_draw_the_same_afterwards(tmp_path, impl):
    keys = {"one": jax.random.key(3, impl=impl), "many": jax.random.split(jax.random.key(4, impl=impl), 5)}
    save_state(tmp_path / "k.npz", keys)
    back = load_state(tmp_path / "k.npz", keys)
    assert back["many"].shape == (5,)
    assert back["one"].dtype == keys["one"].dtype
    np.testing.assert_array_equal(jax.random.normal(back["one"], (3,)), jax.random.normal(keys["one"], (3,)))
    with pytest.raises(InputError, match=r"'one'.*key<fry>"):
        save_state(tmp_path / "k.npz", {"one": jax.random.key(3, impl="rbg")}, overwrite=True)
        load_state(tmp_path / "k.npz", {"one": jax.random.key(3)})


def test_like_may_be_shapes(tmp_path):
    value = {"w": jnp.ones((2, 3)), "key": jax.random.key(0)}
    save_state(tmp_path / "s.npz", value)
    back = load_state(tmp_path / "s.npz", jax.eval_shape(lambda: value))
    assert isinstance(back["w"], jax.Array)
    np.testing.assert_array_equal(back["w"], value["w"])
    assert jax.random.key_data(back["key"]).tolist() == jax.random.key_data(value["key"]).tolist()


@pytest.mark.parametrize(
    ("like", "words"),
    [
        ({"mean": np.zeros(3), "vars": np.zeros(2)}, ["leaf", "vars", "did you mean", "['var']"]),
        ({"mean": np.zeros(3)}, ["['var']", "expected state has not"]),
        ({"mean": np.zeros(4), "var": np.zeros(2)}, ["['mean']", "float64 (3,)", "float64 (4,)"]),
        ({"mean": np.zeros(3, np.float32), "var": np.zeros(2)}, ["['mean']", "float64", "float32"]),
        ({"mean": np.zeros(3), "var": 2.0}, ["['var']", "'array'", "'float'"]),
        ({"mean": np.zeros(3), "var": None}, ["['var']"]),
    ],
)
def test_the_leaf_that_differs_is_named(tmp_path, like, words):
    save_state(tmp_path / "s.npz", {"mean": np.zeros(3), "var": np.zeros(2)})
    with pytest.raises(InputError) as error:
        load_state(tmp_path / "s.npz", like)
    for word in ["s.npz", *words]:
        assert word in str(error.value)


def test_a_double_cannot_be_restored_as_single(tmp_path):
    save_state(tmp_path / "s.npz", np.zeros(3))
    with pytest.raises(InputError, match="jax_enable_x64"):
        load_state(tmp_path / "s.npz", jax.ShapeDtypeStruct((3,), np.float64))


def header(**changes):
    leaves = [{"path": "state", "kind": "array", "dtype": "float64", "shape": [2], "implementation": ""}]
    base = {"format": "jaxest-checkpoint", "version": 1, "leaves": leaves}
    return np.array(json.dumps({**base, **changes}))


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": np.zeros(2)}, ["not a checkpoint", "holds a"]),
        ({"checkpoint": np.array("{")}, ["not a checkpoint", "damaged"]),
        ({"checkpoint": np.array("[]")}, ["not a checkpoint", "damaged"]),
        ({"checkpoint": header(format="other")}, ["not a checkpoint", "other"]),
        ({"checkpoint": header(version=2)}, ["version 2", "expected 1"]),
        ({"checkpoint": header(leaves=[{"path": "state"}])}, ["damaged", "kind"]),
        ({"checkpoint": header()}, ["array of leaf 'state' is missing"]),
        ({"checkpoint": header(), "leaf0": np.zeros(3)}, ["'state'", "(3,)", "(2,)"]),
        ({"checkpoint": header(), "leaf0": np.zeros(2, np.float32)}, ["'state'", "float32"]),
        ({"checkpoint": header(), "leaf0": np.array([1, {}], object)}, ["missing"]),
    ],
)
def test_files_that_are_no_checkpoint(tmp_path, arrays, words):
    np.savez(tmp_path / "s.npz", **arrays)
    with pytest.raises(InputError) as error:
        load_state(tmp_path / "s.npz", np.zeros(2))
    for word in ["s.npz", *words]:
        assert word in str(error.value)


def test_damaged_keys(tmp_path):
    leaf = {"path": "state", "kind": "key", "dtype": "key<fry>", "shape": [], "implementation": "threefry2x32"}
    key = jax.random.key(0)
    for data, words in [(np.zeros(3, np.uint32), "random key"), (np.zeros((2, 2), np.uint32), "header says")]:
        np.savez(tmp_path / "s.npz", checkpoint=header(leaves=[leaf]), leaf0=data)
        with pytest.raises(InputError, match=words):
            load_state(tmp_path / "s.npz", key)


def test_no_file_text_and_existing_output(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_state(tmp_path / "s.npz", 0)
    (tmp_path / "s.npz").write_text("hello")
    with pytest.raises(InputError, match="not a readable NPZ"):
        load_state(tmp_path / "s.npz", 0)
    with pytest.raises(InputError, match="--force"):
        save_state(tmp_path / "s.npz", 0)
    save_state(tmp_path / "s.npz", 5, overwrite=True)
    assert load_state(tmp_path / "s.npz", 0) == 5


@pytest.mark.parametrize("leaf", ["text", object(), np.array(["a"]), np.array([{}], object), 2**70])
def test_leaves_that_are_no_numbers(tmp_path, leaf):
    with pytest.raises(InputError, match=r"s\.npz: leaf \"\['a'\]\""):
        save_state(tmp_path / "s.npz", {"a": leaf})
    assert not (tmp_path / "s.npz").exists()
