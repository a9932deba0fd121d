"""Figs. 1 to 3: the distributions themselves."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.viz import canvas

SHAPES = tuple((kind, size) for kind in ("unimodal", "axisymmetric") for size in (10.0, 100.0, 800.0))
CENTRE = 3 * np.pi / 4
FIG2 = (0.2, 1.0, 10.0, 100.0)
FIG3 = (10.0, 1.0, 0.2)


class Sampled(NamedTuple):
    """Angles drawn from a wrapped Gaussian, and their means."""

    angles: NDArray[np.float64]
    """(n,) rad in [-pi, pi)."""
    naive: float
    """rad, arithmetic mean."""
    circular: float
    """rad."""


def lam(kind: str, size: float) -> NDArray[np.float64]:
    """Return the concentrations (4,) of w, x, y, z; `axisymmetric` leaves the rotation about z free."""
    return np.array([0.0, -size, -size, -size if kind == "unimodal" else 0.0])


def fig1(choice: Choice, say: Say) -> Section:
    """Draw from Bingham distributions about no rotation; second moments of the draws beside the exact ones.

    Source: Sato 2023, fig. 1 (the text that we have does not give the figure's own concentrations).
    """
    import jax

    from jaxest.distributions import bingham

    count = 500 if choice.small else 20_000
    rows, drawn = [], {}
    for number, (kind, size) in enumerate(SHAPES):
        key = jax.random.fold_in(jax.random.key(choice.seed), number)
        params = bingham.standard(lam(kind, size).astype(np.float32))
        draws = jax.jit(lambda key, params: bingham.sample(key, params, (count,)))(key, params)
        q = np.asarray(getattr(draws, "value", draws), np.float64)
        squares = q**2
        moments = np.asarray(bingham.second_moments(params.lam), np.float64)
        drawn[kind, size] = q
        for index, name in ((1, "x"), (3, "z")):
            spread = float(squares[:, index].std() / np.sqrt(count))
            rows.append(Row(f"E[{name}^2] of draws", f"{kind}, lambda -{size:g}", float(squares[:, index].mean()), "1",
                            spread, count, float(moments[index]), "exact moment"))  # fmt: skip
        rows.append(Row("log C", f"{kind}, lambda -{size:g}", float(bingham.log_normalizer(params.lam)), "1"))

    def draw(path: Path) -> None:
        canvas.save(path, (10, 6.6), lambda figure: _spheres(figure, drawn), "Fig. 1: axes turned by Bingham draws")

    return Section("fig1", "Fig. 1: Bingham distributions about no rotation", rows, draw)


def _spheres(figure: Any, drawn: dict[tuple[str, float], NDArray[np.float64]]) -> None:
    for number, ((kind, size), q) in enumerate(drawn.items(), 1):
        axis = figure.add_subplot(2, 3, number, projection="3d")
        w, x, y, z = q[:400].T
        columns = (
            (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
            (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
            (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
        )
        for ends, colour, name in zip(columns, (canvas.RED, canvas.GREEN, canvas.BLUE), "xyz", strict=True):
            axis.scatter(*ends, s=2, color=colour, label=name)
        ticks = (-1, 0, 1)
        axis.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1), xticks=ticks, yticks=ticks, zticks=ticks)
        axis.set_title(f"{kind}, $\\lambda$ = -{size:g}", fontsize=11)
        axis.set_box_aspect((1, 1, 1))
        axis.tick_params(labelsize=7)
    canvas.legend(figure, figure.axes[0], markerscale=5)


def fig2(choice: Choice, say: Say) -> Section:
    """Compare von Mises densities with those of the wrapped Gaussian of variance 1 / kappa.

    Source: Sato 2023, fig. 2 and eq. 4 with its erratum (the second argument is a variance).
    """
    from jaxest.distributions import von_mises

    x = np.linspace(-np.pi, np.pi, 721 if choice.small else 7201)
    mine = {k: np.exp(np.asarray(von_mises.log_prob(x.astype(np.float32), 0.0, k), np.float64)) for k in FIG2}
    other = {k: wrapped_normal(x, 1 / k) for k in FIG2}
    rows = [Row("distance of von Mises and wrapped Gaussian", f"kappa {k:g}, half the L1 norm",
                float(np.trapezoid(np.abs(mine[k] - other[k]), x) / 2), "1") for k in FIG2]  # fmt: skip
    rows += [Row("integral of the density", f"kappa {k:g}", float(np.trapezoid(mine[k], x)), "1", None, None, 1.0,
                 "exact") for k in FIG2]  # fmt: skip

    def paint(figure: Any) -> None:
        axis = canvas.plain(figure.subplots(), xlabel="angle [deg]", ylabel="density [1/rad]")
        for k, colour in zip(FIG2, (canvas.GREY, canvas.GREEN, canvas.ORANGE, canvas.BLUE), strict=True):
            axis.plot(np.rad2deg(x), mine[k], color=colour, label=f"von Mises, $\\kappa$ = {k:g}")
            axis.plot(np.rad2deg(x), other[k], color=colour, linestyle=":", label="wrapped Gaussian, $1/\\kappa$")
        axis.legend(fontsize=8, frameon=False)

    title = "Fig. 2: von Mises against wrapped Gaussian"
    return Section("fig2", title, rows, lambda path: canvas.save(path, (8, 4), paint, title))


def wrapped_normal(x: NDArray[np.float64], variance: float) -> NDArray[np.float64]:
    """Return the density of a Gaussian about 0, wrapped onto the circle.

    Args:
        x: (n,) rad.
        variance: rad2.

    Returns:
        (n,) 1/rad.
    """
    turns = 2 * np.pi * np.arange(-8, 9)[:, None]
    return np.asarray(np.exp(-((x + turns) ** 2) / (2 * variance)).sum(axis=0) / np.sqrt(2 * np.pi * variance))


def fig3(choice: Choice, say: Say) -> Section:
    """Average angles that straddle +-180 deg naively and on the circle.

    Source: Sato 2023, fig. 3 and eq. 5, with their errata (the wrap, the lost means).
    """
    from jaxest.distributions import von_mises
    from jaxest.manifolds import circle

    count = 1000 if choice.small else 100_000
    x = np.linspace(-np.pi, np.pi, 361)
    rows, drawn = [], {}
    for k in FIG3:
        noise = np.random.default_rng(choice.seed).normal(CENTRE, 1 / np.sqrt(k), count)
        angles = np.asarray(circle.wrap(noise.astype(np.float32)), np.float64)
        mean = float(circle.mean_direction(angles.astype(np.float32)))
        drawn[k] = Sampled(angles, float(angles.mean()), mean)
        resultant = np.exp(-1 / (2 * k))
        spread = np.rad2deg(np.sqrt((1 - np.exp(-2 / k)) / (2 * count)) / resultant)
        for name, value in (("circular mean", mean), ("naive mean", drawn[k].naive)):
            error = np.rad2deg(angles.std() / np.sqrt(count)) if name == "naive mean" else spread
            rows.append(Row(name, f"kappa {k:g}", float(np.rad2deg(value)), "deg", float(error), count, 135.0,
                            "3 pi / 4"))  # fmt: skip

    def paint(figure: Any) -> None:
        for axis, (k, one) in zip(figure.subplots(len(FIG3), 1, sharex=True), drawn.items(), strict=True):
            canvas.plain(axis, ylabel=f"$\\kappa$ = {k:g}, density [1/deg]")
            axis.hist(np.rad2deg(one.angles), bins=120, density=True, color="0.8", label="wrapped Gaussian, drawn")
            density = np.exp(np.asarray(von_mises.log_prob(x.astype(np.float32), CENTRE, k)))
            axis.plot(np.rad2deg(x), density * np.pi / 180, color=canvas.BLUE, label="von Mises")
            axis.axvline(np.rad2deg(one.circular), color=canvas.GREEN, label="circular mean")
            axis.axvline(np.rad2deg(one.naive), color=canvas.RED, linestyle="--", label="naive mean")
        figure.axes[0].legend(fontsize=8, frameon=False, loc="upper left")  # above, the title is in the way
        figure.axes[-1].set_xlabel("angle [deg]")

    title = "Fig. 3: naive against circular mean"
    return Section("fig3", title, rows, lambda path: canvas.save(path, (8, 6), paint, title))
