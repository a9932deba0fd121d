"""`jaxest estimate`: from a log to an estimate, a report and a picture."""

import importlib.util
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxest.cli.devices import Devices
from jaxest.cli.output import (
    DONE,
    REJECTED,
    Answer,
    Force,
    Json,
    Verbose,
    bad_input,
    command,
    console,
    note,
    warn,
    working,
)

NAME = "estimate"
EXAMPLES = (
    "jaxest estimate trial.npz --method orientation -o out",
    "jaxest estimate trial.npz -m orientation --sensors gyroscope,accelerometer",
    "jaxest estimate log.csv -m orientation -c config.toml --start 10 --end 60 --force",
    "jaxest estimate log.npz -m deflection --robot arm.urdf --config sensors.toml",
    "jaxest estimate shaken.npz -m onsite --config imus.toml",
    "jaxest estimate arm.npz -m torque --robot arm.urdf --devices 2 --work kept",
    "jaxest estimate hand.npz -m posture --robot hand.xml --config imus.toml",
    "jaxest estimate scan.npz -m slam --robot arm.xml --config sensors.toml",
)


@command
def run(
    log: Annotated[
        Path, typer.Argument(help="Log to read (NPZ, CSV, Parquet, HDF5, bag), in jaxest's layout or anybody's.")
    ],
    method: Annotated[
        str,
        typer.Option(
            "--method", "-m", help="What to estimate: orientation, deflection, onsite, posture, torque, slam."
        ),
    ],
    robot: Annotated[
        Path | None, typer.Option("--robot", "-r", help="Robot (MJCF, URDF), for methods that need one.")
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="TOML with \\[columns] and the method's settings.")
    ] = None,
    sensors: Annotated[
        str | None, typer.Option(help="Kinds of sensor to use, comma-separated; for --method orientation only.")
    ] = None,
    start: Annotated[float | None, typer.Option(help="Leave out what is earlier, s from the first sample.")] = None,
    end: Annotated[float | None, typer.Option(help="Leave out what is later, s from the first sample.")] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for estimate.npz, report.json and a picture.")
    ] = Path("jaxest-out"),
    work: Annotated[
        Path | None,
        typer.Option(help="Folder that keeps finished pieces of a long run; the same command goes on from there."),
    ] = None,
    devices: Devices = None,
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Estimate from a log, and write the estimate with its covariance, a report and a picture into a folder.

    If the log carries its own truth (a stream `orientation`), the errors to it are printed as well. `jaxest inspect`
    prints a first config; docs/config.md has a whole one for each method.
    """
    del verbose, devices
    from jaxest.cli import methods, settings
    from jaxest.cli.window import windowed
    from jaxest.files import existing
    from jaxest.io import read
    from jaxest.io.inspect import doubtful_units
    from jaxest.io.report import Row, report, to_json

    if method not in methods.METHODS:
        raise methods.unknown_name("method", method, methods.METHODS)
    chosen = settings.load(config)
    targets = _targets(out, method, methods.files(method, chosen.method(method)), force)
    if robot is not None:
        existing(robot)
    whole = read(log, chosen.columns)
    if whole.notes:
        note(f"{log.name}: {'; '.join(whole.notes)}")
    kinds = tuple(part.strip() for part in sensors.split(",") if part.strip()) if sensors else None
    begun = time.perf_counter()
    with working(f"estimating the {method} ...") as say:
        request = methods.Request(chosen.method(method), kinds, chosen.nan, robot, work, say)
        outcome = methods.estimate(method, windowed(whole, start, end), request)
    for doubt in doubtful_units(whole):
        warn(f"{log.name}: {doubt}")
    took = time.perf_counter() - begun
    rows = [*outcome.rows, Row("run time", "compilation included", took, "s")]
    text = to_json(report(method, rows))
    written = _written(outcome, targets, text, f"{log.stem}: {method}", force)
    for line in outcome.refused:
        warn(f"do not use this estimate: {line}")
    status = REJECTED if outcome.refused else DONE
    if json:
        return Answer(text, status)
    _shown(outcome, rows, f"{log.stem}: {method}", written)
    if len(targets) < 3:
        note("no picture: pip install 'jaxest[viz]'")
    return Answer(status=status)


def _written(outcome: Any, targets: list[Path], text: str, title: str, force: bool) -> list[Path]:
    """Write all files of an estimate; return which."""
    from jaxest.files import write_bytes, write_text
    from jaxest.io import write

    out = targets[0].parent
    out.mkdir(parents=True, exist_ok=True)
    write(outcome.estimate, targets[0], overwrite=force)
    contents: dict[str, str | bytes] = {targets[1].name: f"{text}\n", **outcome.files}
    for name, content in contents.items():
        if isinstance(content, bytes):
            write_bytes(out / name, content, overwrite=force)
        else:
            write_text(out / name, content, overwrite=force)
    drawn = targets[2:] if outcome.draw else []
    if drawn:
        outcome.draw(drawn[0], title)
    return [targets[0], *(out / name for name in contents), *drawn]


def _shown(outcome: Any, rows: list[Any], title: str, written: list[Path]) -> None:
    """Print the figures, what there is to say, and which files there are."""
    from jaxest.cli import methods
    from jaxest.cli.tables import figures

    page = console()
    page.print(figures(rows[len(methods.SIZE) :], f"{title}, {methods.size(rows)}"))
    note("; ".join(outcome.notes))
    page.print(f"wrote {', '.join(map(str, written))}", soft_wrap=True)


def _targets(out: Path, method: str, files: tuple[str, ...], force: bool) -> list[Path]:
    """The files that every method writes; they and the method's own `files` are checked before anything runs."""
    names = ["estimate.npz", "report.json"]
    names += [f"{method}.png"] if importlib.util.find_spec("matplotlib") else []
    if out.exists() and not out.is_dir():
        raise bad_input(f"{out}: is a file, expected a folder to write into")
    there = [name for name in (*names, *files) if (out / name).exists()]
    if there and not force:
        raise bad_input(f"{out}: {', '.join(there)} exists already and is kept; pass --force to replace it")
    return [out / name for name in names]
