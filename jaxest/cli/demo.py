"""`jaxest demo`: an arm that bends is simulated and its posture estimated, in well under a minute."""

import importlib.util
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from jaxest.cli.output import Answer, Force, Json, Verbose, bad_input, command, console, note, working

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from jaxest.io.report import Row

NAME = "demo"
EXAMPLES = ("jaxest demo", "jaxest demo --seed 3 -o demo --force")
RATE, SECONDS, PARTICLES = 20.0, 60.0, 256
TIP = "site:end_effector"
ENCODER, TILT, MARKER = 0.003, 0.01, 0.005
"""Standard deviations of the sensors, rad, rad, m, as `simulate.deflection.Faults` has them: what a data sheet says."""
SAG = (0.0, 0.1, 0.1, 0.0)
"""rad, how far each joint may be from what its encoder says: gravity bends the shoulder and the elbow, and no more is
known; a yaw about the vertical it does not bend, nor a jaw that weighs nothing."""


class Simulated(NamedTuple):
    """A recording of the arm and what it comes from."""

    measurements: Any
    angles: "NDArray[Any]"
    """(T, 4) rad, how the bent arm stands."""


class Estimated(NamedTuple):
    """What the filter says, (T, 4) rad each."""

    mean: "NDArray[Any]"
    lower: "NDArray[Any]"
    upper: "NDArray[Any]"


@command
def run(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the picture.")] = Path("jaxest-out"),
    seed: Annotated[int, typer.Option(help="Seed of the simulation.")] = 0,
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Let a simulated arm sag for a minute, estimate how it stands from encoders, two IMUs and a marker.

    The encoders know nothing of the sagging, the IMUs drift in yaw, the marker is out of sight now and then. Shown are
    the errors of the encoders alone and of the estimate.
    """
    del verbose
    from jaxest import kinematics, models
    from jaxest.cli.tables import figures
    from jaxest.io.report import Row, report, to_json

    picture = _picture(out, force)
    begun = time.perf_counter()
    robot = kinematics.load(models.path("arm"))
    with working("simulating ...") as say:
        recorded = simulate(robot, seed, SECONDS)
        say("estimating ...")
        found = estimate(robot, recorded.measurements, seed)
    rows = errors(robot, recorded, found)
    rows.append(Row("run time", "simulation and estimate, compilation included", time.perf_counter() - begun, "s"))
    if picture:
        out.mkdir(parents=True, exist_ok=True)
        draw(picture, recorded, found, robot.joint_names)
    if json:
        return Answer(to_json(report(NAME, rows)))
    page = console()
    page.print(figures(rows, f"the packaged arm sags under its own weight, simulated for {SECONDS:g} s at {RATE:g} Hz"))
    page.print(f"wrote {picture}" if picture else "no picture: pip install 'jaxest\\[viz]'", soft_wrap=True)
    note("next: jaxest inspect FILE, jaxest estimate LOG --method deflection --robot ROBOT --config C.toml")
    return Answer()


def sensors() -> "tuple[Any, ...]":
    """Return the arm's sensors, each with its noise: encoders, IMUs on links 2 and 3, a marker on the hand.

    The paper's Table I, the default, is for a robot and sensors far worse than these: bands would be ten times too
    wide, and encoders, which are right where nothing sags, would count for nothing beside a marker.
    """
    import numpy as np

    from jaxest.sensors import Sensor, joint_angle, link_orientation, link_position

    encoders = joint_angle.Params(1 / (np.square(ENCODER) + np.square(SAG)))
    tilt = link_orientation.Params(link_orientation.axisymmetric(2 / TILT**2))  # yaw drifts: nothing is said of it
    return (
        Sensor("joint_angle", "encoders", params=encoders),
        Sensor("link_orientation", "imu2", ("site:imu2",), tilt),
        Sensor("link_orientation", "imu3", ("site:imu3",), tilt),
        Sensor("link_position", "marker", (TIP,), link_position.Params(np.full(3, MARKER**2))),
    )


def simulate(robot: Any, seed: int, seconds: float) -> Simulated:
    """Move the arm slowly at random and record its sensors.

    Args:
        robot: the packaged arm.
        seed: of all that is random.
        seconds: how long.

    Returns:
        Measurements with a leading time axis, and the truth.
    """
    import jax
    import numpy as np

    from jaxest.simulate import deflection

    drawn = jax.jit(
        lambda key: deflection.simulate(robot, sensors(), key=key, duration=seconds, rate_hz=RATE)
    )(jax.random.key(seed))  # fmt: skip
    return Simulated(drawn[0], np.asarray(drawn[1].angles, np.float64))


def estimate(robot: Any, measurements: Any, seed: int) -> Estimated:
    """Run the guided particle filter over the recording.

    Args:
        robot: the packaged arm.
        measurements: from `simulate`.
        seed: of the particles.

    Returns:
        The joints' means and 95 % intervals.
    """
    import jax
    import numpy as np

    from jaxest.filters import run as drive
    from jaxest.systems import deflection

    system = deflection.build(robot, sensors(), particles=PARTICLES, proposal=deflection.guided)
    params = jax.tree.map(lambda x: np.asarray(x, np.float32), system.default_params)
    key = jax.random.key(seed + 1)
    start = jax.jit(lambda key: system.init(params, key=key))(key)
    _, found = drive(system.step, params, start, measurements, key=key, history=deflection.with_interval)
    mean, lower, upper = (np.asarray(x, np.float64) for x in (found.info.mean, found.lower, found.upper))
    return Estimated(mean, mean + lower, mean + upper)


def errors(robot: Any, recorded: Simulated, found: Estimated) -> "list[Row]":
    """Compare the estimate with the truth, beside the encoders taken at their word.

    Args:
        robot: the packaged arm.
        recorded: from `simulate`.
        found: from `estimate`.

    Returns:
        RMSE of each joint and of the hand's position, and how much of the truth is inside the intervals.
    """
    import jax
    import jax.numpy as jnp
    import numpy as np

    from jaxest import kinematics
    from jaxest.io.report import Row
    from jaxest.metrics import circular_error

    tip = jax.jit(jax.vmap(lambda q: kinematics.forward(robot, q, [TIP]).position[0]))
    naive, truth = np.asarray(recorded.measurements.encoders.value, np.float64), recorded.angles

    def row(metric: str, mine: Any, other: Any, unit: str) -> Row:
        value, reference = (float(np.sqrt(np.mean(x**2))) for x in (mine, other))
        return Row(metric, "estimate", value, unit, None, len(mine), reference, "encoders alone", reference / value)

    mine, other = (np.rad2deg(circular_error(q, truth)) for q in (found.mean, naive))
    rows = [row(f"{name}: RMSE", mine[:, j], other[:, j], "deg") for j, name in enumerate(robot.joint_names)]
    here, there, true = (np.asarray(tip(jnp.asarray(q, jnp.float32)), np.float64) for q in (found.mean, naive, truth))
    far, further = (1e3 * np.linalg.norm(x - true, axis=1) for x in (here, there))
    rows.append(row("hand position: RMSE", far, further, "mm"))
    away = circular_error(truth, found.mean)
    inside = (away >= found.lower - found.mean) & (away <= found.upper - found.mean)
    rows.append(Row("truth inside the 95 % band", "estimate", 100 * float(inside.mean()), "%", None, inside.size))
    return rows


def draw(path: Path, recorded: Simulated, found: Estimated, names: "tuple[str, ...]") -> None:
    """Draw the estimate with its 95 % band, the truth and the encoders.

    Args:
        path: of the picture.
        recorded: from `simulate`.
        found: from `estimate`.
        names: of the joints.
    """
    import numpy as np

    from jaxest.viz import joints

    time = np.arange(len(found.mean)) / RATE
    joints.draw(path, time, *found, names=names, reference=np.asarray(recorded.measurements.encoders.value),
                truth=recorded.angles, title="jaxest demo: an arm that sags, simulated")  # fmt: skip


def _picture(out: Path, force: bool) -> Path | None:
    if not importlib.util.find_spec("matplotlib"):
        return None
    if out.exists() and not out.is_dir():
        raise bad_input(f"{out}: is a file, expected a folder to write into")
    target = out / "demo.png"
    if target.exists() and not force:
        raise bad_input(f"{target}: exists already and is kept; pass --force to replace it")
    return target
