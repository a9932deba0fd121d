"""Static selection of rows against NumPy's indexing, forwards and backwards."""

import jax
import numpy as np
import pytest

from jaxest import kinematics
from jaxest.kinematics.take import take

ROWS = [
    [0, 1, 2, 3, 4],
    [4, 0, 0, 2],
    [-1, 0, 1, -1, -1, 3, 2, 2],
    [1, 2, 3, 2, 3, 4, 0, 1],
    [-1, -1],
    [],
]


@pytest.mark.parametrize("rows", ROWS)
def test_takes_the_rows_and_fills_the_missing(rows):
    array = np.arange(15.0, dtype=np.float32).reshape(5, 3)
    expected = np.array([array[r] if r >= 0 else np.full(3, 7.0) for r in rows], np.float32).reshape(-1, 3)
    np.testing.assert_array_equal(take(array, rows, 7.0), expected)
    np.testing.assert_array_equal(jax.jit(jax.vmap(lambda x: take(x, rows, 7.0), 1, 1))(array), expected)


@pytest.mark.parametrize("rows", ROWS)
def test_gradient_counts_how_often_a_row_was_taken(rows):
    weights = np.arange(1.0, len(rows) + 1, dtype=np.float32)
    expected = np.zeros(5, np.float32)
    for r, w in zip(rows, weights, strict=True):
        expected[r] += w if r >= 0 else 0
    found = jax.grad(lambda x: (take(x, rows) * weights).sum())(np.ones(5, np.float32))
    np.testing.assert_array_equal(found, expected)


def test_nothing_can_be_taken_from_nothing_but_what_is_missing():
    np.testing.assert_array_equal(take(np.zeros((0, 2), np.float32), [-1], 3.0), [[3.0, 3.0]])


def test_frames_that_nothing_moves_stand_where_they_are():
    robot = kinematics.load(
        """<mujoco><worldbody>
        <body name="base" pos="1 2 3"><site name="top" pos="0 0 1"/>
          <body name="arm"><joint axis="0 0 1"/><geom size=".1"/></body></body>
        </worldbody></mujoco>"""
    )
    q = np.array([0.3], np.float32)
    for frames in (["base", "site:top"], ["base"], ["arm", "site:top"]):
        poses = kinematics.forward(robot, q, frames)
        expected = [[1, 2, 4] if name == "site:top" else [1, 2, 3] for name in frames]
        np.testing.assert_array_equal(poses.position, np.array(expected, np.float32))
    np.testing.assert_array_equal(jax.jacfwd(lambda q: kinematics.forward(robot, q, ["base"]).position)(q), 0)
