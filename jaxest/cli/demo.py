"""`jaxest demo`: an IMU is simulated and its orientation estimated, in a few seconds."""

import importlib.util
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from jaxest.cli.output import Answer, Force, Json, Verbose, bad_input, command, console, note, working

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from jaxest.io.report import Row

NAME = "demo"
EXAMPLES = ("jaxest demo", "jaxest demo --seed 3 -o demo --force")
RATE, SECONDS, SENSORS = 100.0, 60.0, ("gyroscope", "accelerometer", "magnetometer")


@command
def run(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the picture.")] = Path("jaxest-out"),
    seed: Annotated[int, typer.Option(help="Seed of the simulation.")] = 0,
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Simulate a minute of a turning, shaken IMU, estimate its orientation with 6 and 9 axes, show how wrong it is."""
    del verbose
    from jaxest.cli.tables import figures
    from jaxest.io.report import Row, report, to_json

    picture = _picture(out, force)
    begun = time.perf_counter()
    with working("simulating and estimating ..."):
        simulated = simulate(seed)
        results = {axes: estimate(*simulated, axes) for axes in (6, 9)}
    rows = [row for rows, _ in results.values() for row in rows]
    rows.append(Row("run time", "simulation and two estimates, compilation included", time.perf_counter() - begun, "s"))
    if picture:
        out.mkdir(parents=True, exist_ok=True)
        results[9][1](picture)
    if json:
        return Answer(to_json(report(NAME, rows)))
    page = console()
    page.print(figures(rows, f"{SECONDS:g} s of a simulated IMU, {RATE:g} Hz"))
    page.print(f"wrote {picture}" if picture else "no picture: pip install 'jaxest\\[viz]'", soft_wrap=True)
    note("next: jaxest inspect FILE, jaxest estimate LOG --method orientation")
    return Answer()


def simulate(seed: int, seconds: float = SECONDS) -> "tuple[Any, NDArray[Any]]":
    """Simulate an IMU with a magnetometer that is turned and shaken.

    Args:
        seed: of all that is random.
        seconds: how long.

    Returns:
        Measurements (`jaxest.filters.complementary.Imu`, leading axis T), and the true orientation (T, 4) wxyz.
    """
    import jax
    import numpy as np

    from jaxest.systems import orientation

    system = orientation.build(sensors=SENSORS)
    params = jax.tree.map(np.float32, system.default_params)
    draw = jax.jit(partial(system.simulate, steps=round(seconds * RATE), rate_hz=RATE, shaking=0.5))
    measurements, truth = draw(params, key=jax.random.key(seed))
    return measurements, np.asarray(truth.quaternion)


def estimate(measurements: Any, truth: "NDArray[Any]", axes: int) -> "tuple[list[Row], Callable[[Path], None]]":
    """Estimate the orientation and compare it with the truth.

    Args:
        measurements: from `simulate`.
        truth: (T, 4) wxyz.
        axes: 9, or 6 to leave out the magnetometer.

    Returns:
        Rows of errors, and a function that draws the picture at a path.
    """
    import jax
    import numpy as np

    from jaxest.cli import orientation_errors
    from jaxest.filters import run as drive
    from jaxest.systems import orientation

    heading = axes == 9
    system = orientation.build(sensors=SENSORS[: axes // 3], covariance=True)
    params = jax.tree.map(np.float32, system.default_params)
    used = measurements if heading else measurements._replace(magnetometer=None)
    _, info = drive(system.step, params, system.init(params), used)
    quaternion, covariance = np.asarray(info.quaternion), np.asarray(info.covariance)
    rows = orientation_errors.rows(quaternion, truth, covariance=covariance, heading=heading, condition=f"{axes} axes")

    def draw(path: Path) -> None:
        from jaxest.viz import orientation as picture

        time = np.arange(1, len(truth) + 1) / RATE
        title = f"jaxest demo: simulated IMU, {axes} axes"
        picture.draw(path, time, quaternion, covariance, truth=truth, heading=heading, title=title)

    return rows, draw


def _picture(out: Path, force: bool) -> Path | None:
    if not importlib.util.find_spec("matplotlib"):
        return None
    if out.exists() and not out.is_dir():
        raise bad_input(f"{out}: is a file, expected a folder to write into")
    target = out / "demo.png"
    if target.exists() and not force:
        raise bad_input(f"{target}: exists already and is kept; pass --force to replace it")
    return target
