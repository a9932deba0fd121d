"""The exact filter of one angle, by quadrature on a grid: sums of periodic functions converge beyond all orders."""

import numpy as np


def grid(count):
    """(count,) angles, rad, from -pi on."""
    return -np.pi + 2 * np.pi * np.arange(count) / count


def filter_angle(prior, transition, likelihoods):
    """Filter; densities on the grid are with respect to the angle.

    prior: (n,) density before the first step. transition: periodic density of the angle moved, for arrays.
    likelihoods: (T, n). Returns densities (T, n) after each step and log-likelihood increments (T,).
    """
    n = len(prior)
    width = 2 * np.pi / n
    angles = grid(n)
    kernel = transition(angles[:, None] - angles[None, :])
    density, densities, increments = prior, [], []
    for likelihood in likelihoods:
        predicted = np.zeros(n)
        for i in range(n):
            predicted[i] = np.sum(kernel[i] * density) * width
        joint = predicted * likelihood
        evidence = np.sum(joint) * width
        density = joint / evidence
        densities.append(density)
        increments.append(np.log(evidence))
    return np.array(densities), np.array(increments)


def wrapped_normal(sd, turns=12):
    """Density of a Gaussian angle taken modulo 2 pi."""

    def density(angle):
        around = np.asarray(angle)[..., None] + 2 * np.pi * np.arange(-turns, turns + 1)
        return np.sum(np.exp(-((around / sd) ** 2) / 2), axis=-1) / (sd * np.sqrt(2 * np.pi))

    return density


def quantile(density, centre, level):
    """Distance from the centre, within half a turn, below which the share `level` lies."""
    n = len(density)
    distance = (grid(n) - centre + np.pi) % (2 * np.pi) - np.pi
    order = np.argsort(distance)
    share = density[order] * 2 * np.pi / n
    return np.interp(level, np.cumsum(share) - share / 2, distance[order])
