"""Fig. 9: how the filter shortens a rod that is shaken too fast for its sampling rate."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.filters import savitzky_golay as sg
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.viz import canvas

WINDOWS = ((3, 5), (3, 3), (5, 5), (5, 3), (7, 3), (10, 3))
BORDER = 10 ** (-3 / 20)
LENGTH, RATE = 0.2, 100.0  # m, Hz; the ratio depends on neither
PAPER = {(3, 5): 0.3}  # f / f_sample at -3 dB


def fig9(choice: Choice, say: Say) -> Section:
    """Rotate an IMU at (L, 0, 0) with the rate (0, 0, sin 2 pi f t), without noise, and estimate L.

    The paper's way evaluates rates, derivatives and forces at the window's centre; with accelerations as read, only
    the rates are smoothed. Ours averages all of them as the derivative does.

    Source: Sato 2024, section V-A, Fig. 9.
    """
    shares = np.linspace(0.005, 0.495, 30 if choice.small else 197)
    rows, curves = [], {}
    for n, m in WINDOWS:
        say(f"fig. 9: N = {n}, M = {m}")
        found = np.array([_lengths(share, n, m) for share in shares])
        curves[n, m] = found
        for column, how in enumerate(("forces smoothed too", "forces as read", "averaged (ours)")):
            at = _crossing(shares, found[:, column])
            paper = PAPER.get((n, m)) if column == 0 else None
            rows.append(Row("-3 dB at f / f_sample", f"N = {n}, M = {m}, {how}", at, "1", reference=paper,
                            reference_name="paper" if paper else ""))  # fmt: skip

    def paint(figure: Any) -> None:
        _paint(figure, shares, curves)

    title = "Fig. 9: estimated over true length against the frequency of shaking"
    return Section("fig9", title, rows, lambda path: canvas.save(path, (11, 4.2), paint, title))


def _lengths(share: float, n: int, m: int) -> tuple[float, float, float]:
    """Least-squares L over the true one: forces smoothed, forces as read, all averaged."""
    time = np.arange(-n, n + 1) / RATE
    fit = sg.weights(time.astype(np.float32), np.ones(2 * n + 1, bool), 0.0, degree=m)  # type: ignore[arg-type]
    value, slope = (np.asarray(x, np.float64) for x in (fit.value, fit.derivative))
    mean = np.asarray(sg.averaging(time.astype(np.float32), fit.derivative), np.float64)  # type: ignore[arg-type]
    w = 2 * np.pi * share * RATE
    at = np.arange(2000)[:, None] / RATE * np.sqrt(2) + time[None]  # phases that fill the circle
    rate, turn = np.sin(w * at), w * np.cos(w * at)
    force = LENGTH * np.stack([-rate * rate, turn], axis=-1)
    seen, turned = rate @ value, rate @ slope
    lengths = []
    for o, f in (
        (np.stack([-seen * seen, turned]), (force * value[:, None]).sum(axis=1)),
        (np.stack([-seen * seen, turned]), force[:, n]),
        (np.stack([-(rate * rate) @ mean, turned]), (force * mean[:, None]).sum(axis=1)),
    ):
        lengths.append(float(np.sum(o * f.T) / np.sum(o * o) / LENGTH))
    return lengths[0], lengths[1], lengths[2]


def _crossing(shares: NDArray[np.float64], ratio: NDArray[np.float64]) -> float | None:
    """Where the ratio first leaves the band between the border and its inverse; None where it never does."""
    away = (ratio < BORDER) | (ratio > 1 / BORDER)
    return float(shares[int(np.argmax(away))]) if away.any() else None


def _paint(figure: Any, shares: NDArray[np.float64], curves: dict[tuple[int, int], NDArray[np.float64]]) -> None:
    axes = figure.subplots(1, 3, sharey=True)
    for column, title in enumerate(("rates and forces smoothed", "forces as read", "averaged (ours)")):
        axis = canvas.plain(axes[column], xlabel="f / f_sample", title=title)
        for (n, m), found in curves.items():
            # Beyond its first pole or zero a curve says nothing more.
            end = int(np.argmax(np.append(np.abs(found[:, column] - 1) > 0.8, True)))
            axis.plot(shares[:end], found[:end, column], linewidth=1.2, label=f"N = {n}, M = {m}")
        axis.axhline(BORDER, color=canvas.RED, linestyle="--", linewidth=0.9, label="-3 dB")
        axis.set_ylim(0, 1.8)
    axes[0].set_ylabel("estimated / true length")
    axes[0].legend(fontsize=8, frameon=False)


__all__ = ["fig9"]
