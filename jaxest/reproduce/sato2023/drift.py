"""Fig. 10: an IMU's yaw drift, with unimodal against axisymmetric Bingham likelihoods."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxest.io.report import Row
from jaxest.metrics import circular_error
from jaxest.reproduce import Choice, Say, Section, seed_of
from jaxest.reproduce.sato2023 import arm
from jaxest.sensors import link_orientation
from jaxest.systems import deflection
from jaxest.types import Reading
from jaxest.viz import canvas

DRIFTS = (0.0, 1.0)  # deg/s
RUNS = 4
KINDS = {"axisymmetric": link_orientation.axisymmetric(), "unimodal": link_orientation.unimodal()}
SAYS = {"axisymmetric, 1": "paper: absorbs the drift", "unimodal, 1": "paper: drifts"}
FILTERS = {"bootstrap, N = 2048": (2048, deflection.bootstrap), "guided, N = 256": (256, deflection.guided)}


def fig10(choice: Choice, say: Say) -> Section:
    """Let both IMUs drift to the left and see what the estimate of the yaw makes of it.

    Source: Sato 2023, fig. 10, section IV-E.
    """
    runs, seconds = (1, 6.0) if choice.small else (RUNS, arm.SECONDS)
    scenes = [arm.scene(seed_of(choice, i), seconds=seconds, drift=0.0) for i in range(runs)]
    rows, shown = [], {}
    for label, (count, propose) in FILTERS.items():
        for kind, lam in KINDS.items():
            noise = link_orientation.Params(lam=lam)
            given = arm.params(imu2=noise, imu3=noise)
            for speed in DRIFTS:
                say(f"fig. 10: {kind}, {speed:g} deg/s")
                found = [arm.estimate(drifting(s, speed), seed_of(choice, i), arm.system(count, propose), given)
                         for i, s in enumerate(scenes)]  # fmt: skip
                shown[label, kind, speed] = found[0]
                rows += _rows(f"{kind}, {speed:g} deg/s, {label}", scenes, found)

    def paint(figure: Any) -> None:
        axes = figure.subplots(2, len(KINDS), sharex=True, sharey="row", squeeze=False)
        label = "bootstrap, N = 2048"
        for column, kind in enumerate(KINDS):
            canvas.plain(axes[0, column], title=kind)
            for speed, colour in zip(DRIFTS, (canvas.GREY, canvas.BLUE), strict=True):
                for joint in (0, 1):
                    axes[joint, column].plot(
                        scenes[0].time, np.rad2deg(shown[label, kind, speed].mean[:, joint]), color=colour,
                        linewidth=0.9 if speed else 2.4, label=f"drift {speed:g} deg/s",
                    )  # fmt: skip
            for joint in (0, 1):
                axes[joint, column].plot(scenes[0].time, np.rad2deg(scenes[0].angles[:, joint]), color=canvas.RED,
                                         linewidth=1.3, label="effective")  # fmt: skip
            canvas.plain(axes[1, column], xlabel="time [s]")
        axes[0, 0].set_ylabel("yaw [deg]")
        axes[1, 0].set_ylabel("shoulder [deg]")
        canvas.legend(figure, axes[0, 0])

    title = "Fig. 10: yaw drift of the IMUs"
    return Section("fig10", title, rows, lambda path: canvas.save(path, (10, 6), paint, title))


def drifting(scene: arm.Scene, speed: float) -> Any:
    """Return the measurements of encoders and IMUs with a yaw that drifts to the left by `speed` deg/s."""
    measurements = arm.using(scene, ("encoders", *arm.IMUS))
    half = np.deg2rad(speed) * scene.time / 2
    for name in arm.IMUS:
        reading = getattr(measurements, name)
        turned: Any = _yawed(half, np.asarray(reading.value))
        measurements = measurements._replace(**{name: Reading(turned, reading.valid)})
    return measurements


def _yawed(half: NDArray[np.float64], q: NDArray[Any]) -> NDArray[Any]:
    """Turn (T, 4) wxyz about the world's z by twice `half` (T,)."""
    c, s = np.cos(half), np.sin(half)
    w, x, y, z = q.T
    return np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=1).astype(q.dtype)


def _rows(condition: str, scenes: list[arm.Scene], found: list[arm.Result]) -> list[Row]:
    error = [np.rad2deg(circular_error(r.mean, s.angles)) for s, r in zip(scenes, found, strict=True)]
    figures = (
        ("yaw RMSE", [arm.rms(e[:, 0]) for e in error]),
        ("joints RMSE", [arm.rms(e) for e in error]),
        ("yaw error, mean of the last 10 s", [float(e[-100:, 0].mean()) for e in error]),
    )
    said = SAYS.get(condition.split(" deg/s")[0])
    return [Row(m, condition, float(np.mean(v)), "deg", float(np.std(v)), len(v), reference_name=said)
            for m, v in figures]  # fmt: skip
