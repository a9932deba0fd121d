"""`jaxest demo`: an IMU on a moving arm is simulated and its orientation estimated, in a few seconds."""

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
RATE, SECONDS, FRAME = 200.0, 60.0, "site:imu3"
SENSORS = ("gyroscope", "accelerometer", "magnetometer")


@command
def run(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the picture.")] = Path("jaxest-out"),
    seed: Annotated[int, typer.Option(help="Seed of the simulation.")] = 0,
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Move a simulated arm for a minute, estimate the orientation of the IMU on it, show how wrong that is."""
    del verbose
    from jaxest.cli.tables import figures
    from jaxest.io.report import Row, report, to_json

    picture = _picture(out, force)
    begun = time.perf_counter()
    with working("simulating and estimating ..."):
        simulated = simulate(seed, SECONDS)
        results = {axes: estimate(*simulated, axes) for axes in (6, 9)}
    rows = [row for rows, _ in results.values() for row in rows]
    rows.append(Row("run time", "simulation and two estimates, compilation included", time.perf_counter() - begun, "s"))
    if picture:
        out.mkdir(parents=True, exist_ok=True)
        results[9][1](picture)
    if json:
        return Answer(to_json(report(NAME, rows)))
    page = console()
    page.print(figures(rows, f"an IMU on the forearm of the packaged arm, simulated for {SECONDS:g} s at {RATE:g} Hz"))
    page.print(f"wrote {picture}" if picture else "no picture: pip install 'jaxest\\[viz]'", soft_wrap=True)
    note("next: jaxest inspect FILE, jaxest estimate LOG --method orientation")
    return Answer()


def simulate(seed: int, seconds: float) -> "tuple[Any, NDArray[Any]]":
    """Move the packaged arm at random and record the IMU on its forearm.

    Args:
        seed: of all that is random.
        seconds: how long.

    Returns:
        Measurements (`jaxest.filters.complementary.Imu`, leading axis T), and the true orientation (T, 4) wxyz.
    """
    import jax
    import numpy as np

    from jaxest import kinematics, models
    from jaxest.simulate import imu, trajectories

    robot = kinematics.load(models.path("arm"))
    moves, noise = jax.random.split(jax.random.key(seed))
    motion = partial(trajectories.configuration, trajectories.random_motion(moves, robot, reach=0.3))
    measurements, record = imu.record(robot, motion, FRAME, key=noise, duration=seconds, rate_hz=RATE)
    return measurements, np.asarray(record.truth.quaternion)


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

        time = np.arange(len(truth)) / RATE
        title = f"jaxest demo: IMU on the forearm of an arm, simulated, {axes} axes"
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
