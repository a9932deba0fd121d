"""The Kalman filter and smoother of `bench.kalman` as a loop in NumPy: rotation matrices, derivatives by hand."""

from typing import NamedTuple

import numpy as np


class Loop(NamedTuple):
    """The model's numbers."""

    dt: float
    turn: float
    walk: float
    seen: float
    turned: float
    biased: float
    earth: np.ndarray

    def filter(self, rates: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Filter a recording.

        Args:
            rates: (T, 3) rad/s.
            seen: (T, 2, 3).

        Returns:
            Orientations (T, 3, 3), biases (T, 3), covariances (T, 6, 6) of rotation on the right and bias.
        """
        turns, biases, covariances, _ = self._forward(rates, seen)
        return turns[1:], biases[1:], covariances[1:]

    def _forward(self, rates: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, ...]:
        steps = len(rates)
        turns, biases, covariances = np.empty((steps + 1, 3, 3)), np.zeros((steps + 1, 3)), np.empty((steps + 1, 6, 6))
        moved = np.empty((steps, 6, 6))
        turn, bias = np.eye(3), np.zeros(3)
        covariance = np.diag(np.repeat([self.turned**2, self.biased**2], 3))
        turns[0], covariances[0] = turn, covariance
        noise = np.diag(np.repeat([self.turn**2, self.walk**2], 3)) * self.dt
        for k in range(steps):
            move = (rates[k] - bias) * self.dt
            moved[k] = self._transition(move)
            covariance = moved[k] @ covariance @ moved[k].T + noise
            turn = turn @ rotation(move)
            expected = self.earth @ turn
            slope = np.zeros((6, 6))
            slope[:3, :3], slope[3:, :3] = cross(expected[0]), cross(expected[1])
            spread = slope @ covariance @ slope.T + self.seen**2 * np.eye(6)
            gain = np.linalg.solve(spread, slope @ covariance).T
            step = gain @ (seen[k] - expected).ravel()
            left = np.eye(6) - gain @ slope
            covariance = left @ covariance @ left.T + self.seen**2 * gain @ gain.T
            turn, bias = turn @ rotation(step[:3]), bias + step[3:]
            carry = np.eye(6)
            carry[:3, :3] = right_jacobian(step[:3])
            covariance = carry @ covariance @ carry.T
            turns[k + 1], biases[k + 1], covariances[k + 1] = turn, bias, covariance
        return turns, biases, covariances, moved

    def smooth(self, rates: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Smooth a recording by Rauch, Tung and Striebel's pass backwards, linearised at the filter's estimates.

        Args:
            rates: (T, 3) rad/s.
            seen: (T, 2, 3).

        Returns:
            Orientations (T, 3, 3), biases (T, 3), and covariances (T, 6, 6) where the filter stood.
        """
        turns, biases, covariances, moved = self._forward(rates, seen)
        noise = np.diag(np.repeat([self.turn**2, self.walk**2], 3)) * self.dt
        steps = len(rates)
        error, covariance = np.zeros(6), covariances[-1]
        out_turns, out_biases, out = turns[1:].copy(), biases[1:].copy(), covariances[1:].copy()
        for k in range(steps - 1, 0, -1):
            move = (rates[k] - biases[k]) * self.dt
            ahead = turns[k] @ rotation(move)
            # The step's end is written in the next estimate's tangent space.
            jump = np.concatenate([rotation_vector(turns[k + 1].T @ ahead), biases[k] - biases[k + 1]])
            carry = np.eye(6)
            carry[:3, :3] = np.linalg.inv(right_jacobian(jump[:3]))
            forward = carry @ moved[k]
            spread = forward @ covariances[k] @ forward.T + carry @ noise @ carry.T
            gain = np.linalg.solve(spread, forward @ covariances[k]).T
            covariance = covariances[k] + gain @ (covariance - spread) @ gain.T
            error = gain @ (error - jump)
            out_turns[k - 1], out_biases[k - 1] = turns[k] @ rotation(error[:3]), biases[k] + error[3:]
            out[k - 1] = covariance
        return out_turns, out_biases, out

    def _transition(self, move: np.ndarray) -> np.ndarray:
        slope = np.eye(6)
        slope[:3, :3] = rotation(move).T
        slope[:3, 3:] = -right_jacobian(move) * self.dt
        return slope


def cross(v: np.ndarray) -> np.ndarray:
    """Return the matrix of the cross product with v."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def rotation(v: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a rotation vector."""
    angle = np.sqrt(v @ v)
    across = cross(v)
    if angle < 1e-4:
        return np.eye(3) + across + across @ across / 2
    return np.eye(3) + np.sin(angle) / angle * across + (1 - np.cos(angle)) / angle**2 * across @ across


def rotation_vector(matrix: np.ndarray) -> np.ndarray:
    """Return the rotation vector of a rotation by less than half a turn."""
    axis = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]) / 2
    sine = np.sqrt(axis @ axis)
    return axis if sine < 1e-6 else axis * np.arctan2(sine, (np.trace(matrix) - 1) / 2) / sine


def right_jacobian(v: np.ndarray) -> np.ndarray:
    """Return how the rotation's body rate follows from the rate of its vector."""
    angle = np.sqrt(v @ v)
    across = cross(v)
    if angle < 1e-4:
        return np.eye(3) - across / 2 + across @ across / 6
    curl = (1 - np.cos(angle)) / angle**2
    return np.eye(3) - curl * across + (angle - np.sin(angle)) / angle**3 * across @ across
