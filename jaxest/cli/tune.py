"""`jaxest tune`: from logs to the config under which a method does best on them."""

import importlib.util
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from jaxest.cli.devices import Devices, Join
from jaxest.cli.output import (
    DONE,
    Answer,
    Force,
    Json,
    Verbose,
    bad_input,
    command,
    console,
    json_object,
    note,
    working,
)

NAME = "tune"
EXAMPLES = (
    "jaxest tune walk1.npz walk2.npz walk3.npz --method orientation --held-out 1",
    "jaxest tune trial.npz -m orientation -c start.toml --free proportional_gain,integral_gain --starts 8",
    "jaxest tune a.npz b.npz c.npz -m orientation --starts 8 --devices 2",
    "jaxest tune a.npz b.npz -m deflection --robot arm.urdf -c sensors.toml --free walk,sensors.encoders.concentration",
    "jaxest tune swing.npz -m torque --robot arm.xml",
    "jaxest tune shaken.npz -m onsite --objective consistency --free force_noise",
    "jaxest tune a.npz -m deflection --robot arm.urdf -c sensors.toml --objective relaxed --free walk",
)
SHOWN = 12  # parameters that a picture has room for


@command
def run(
    logs: Annotated[list[Path], typer.Argument(help="Logs to tune on.")],
    method: Annotated[str, typer.Option("--method", "-m", help="orientation, deflection, onsite or torque.")],
    robot: Annotated[
        Path | None, typer.Option("--robot", "-r", help="Robot (MJCF, URDF), where one is needed.")
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", "-c", help="TOML to start from.")] = None,
    truth: Annotated[
        list[Path] | None,
        typer.Option("--truth", "-t", help="Log with the truth, one for each log; the log's own if left out."),
    ] = None,
    objective: Annotated[str, typer.Option(help="error, likelihood, consistency or relaxed; by the method.")] = "",
    free: Annotated[
        str | None,
        typer.Option(help="Parameters to move, separated by commas: walk, a+b ties two, walk=positive names a range."),
    ] = None,
    starts: Annotated[int, typer.Option(min=1, help="How many starts; the config's own is the first.")] = 4,
    spread: Annotated[float, typer.Option(min=0, help="How far apart they are; 1 is a factor e.")] = 1.0,
    held_out: Annotated[int, typer.Option(min=0, help="Keep the last N logs out of the tuning, to judge it.")] = 0,
    evaluations: Annotated[int, typer.Option(min=1, help="Evaluations of each start, at most.")] = 60,
    seed: Annotated[int, typer.Option(help="Of starts, mini-batches and particles.")] = 0,
    checkpoint: Annotated[
        Path | None, typer.Option(help="File for the search's state; where it exists, the search goes on from it.")
    ] = None,
    devices: Devices = None,
    join: Join = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Tuned config to write; a picture goes beside it.")] = Path(
        "tuned.toml"
    ),
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Tune a method's parameters on logs by gradient, and write a config for `estimate`.

    Printed are each parameter's standard error, and which the logs cannot tell: those are better left alone.
    """
    del verbose, devices, join
    import jax

    from jaxest.cli import tunable, tuned
    from jaxest.io import write_config
    from jaxest.io.report import report

    targets = _targets(out, force)
    tunable.known(method)
    chosen, given = _prepare(logs, truth, method, robot, config, objective, free)
    if held_out >= len(given.recordings):
        raise bad_input(f"--held-out {held_out}: got {len(logs)} logs, expected at least one to tune on")
    begun = time.perf_counter()
    with jax.enable_x64(True) if jax.numpy.dtype(given.dtype) == "float64" else nullcontext():
        with working("tuning ...") as say:
            found, judged = _search(given, starts, spread, held_out, evaluations, seed, checkpoint, say)
        if jax.process_index():
            return Answer(status=DONE)  # the first process writes and prints
        tables = {**({"columns": chosen.columns} if chosen.columns else {}), "nan": chosen.nan, **chosen.tables}
        write_config(out, {**tables, method: given.settings(found.params)}, overwrite=force)
        kept = tuned.distinct(given.space, judged.estimates)
        if found.trace.value.size:  # a search that had ended before has no path to draw
            for picture in targets[1:]:
                tuned.draw(picture, given, found, held_out > 0, f"{method}: {given.label}", list(kept)[:SHOWN])
        else:
            del targets[1:]
    rows = list(kept.values())
    shown = tuned.rows(given, found, judged, held_out, time.perf_counter() - begun)
    loose = tuned.warned(rows, len(given.recordings) - held_out, given.space.size)
    if json:
        return Answer(json_object(report(NAME, [*shown, *tuned.parameters(given, rows)]), unidentified=loose))
    from jaxest.cli.tables import figures

    page = console()
    page.print(figures(shown, f"{method}: {given.label}, {len(given.recordings)} log(s), stopped: {found.stopped}"))
    page.print(tuned.table(given, rows))
    page.print(f"wrote {', '.join(map(str, targets))}", soft_wrap=True)
    return Answer(status=DONE)


def _targets(out: Path, force: bool) -> list[Path]:
    """The config and, where it can be drawn, the picture beside it; checked before anything runs."""
    found = [out, out.with_suffix(".png")] if importlib.util.find_spec("matplotlib") else [out]
    for file in found:
        if file.exists() and not force:
            raise bad_input(f"{file} exists already and is kept; pass --force to replace it")
    return found


def _prepare(
    logs: list[Path], truth: list[Path] | None, method: str, robot: Path | None, config: Path | None, objective: str,
    free: str | None,
) -> tuple[Any, Any]:  # fmt: skip
    """Read everything and let the method make a tuning of it."""
    from jaxest.cli import methods, settings, tunable
    from jaxest.files import existing
    from jaxest.io import read

    if truth and len(truth) != len(logs):
        raise bad_input(f"--truth: got {len(truth)} for {len(logs)} logs, expected one each, or none")
    if robot is not None:
        if method in methods.ROBOTLESS:
            raise bad_input(f"--robot {robot}: the method {method!r} knows no robot, expected none; leave it out")
        existing(robot)
    chosen = settings.load(config)
    sources, said = [], set()
    for i, path in enumerate(logs):
        log = read(path, chosen.columns)
        if log.notes and log.notes not in said:  # logs of one kind say the same
            said.add(log.notes)
            note(f"{path.name}: {'; '.join(log.notes)}")
        sources.append(tunable.Source(log, read(truth[i]) if truth else log))
    request = methods.Request(chosen.method(method), None, chosen.nan, robot)
    given = tunable.prepare(method, sources, request, objective, _free(free))
    if truth and all(one.truth is None for one in given.recordings):
        raise bad_input(f"--truth: the objective '{given.label}' knows no truth; leave it out")
    return chosen, given


def _free(text: str | None) -> dict[str, str | None]:
    """`a+b,c=positive` as paths and names of constraints."""
    found: dict[str, str | None] = {}
    for part in (text or "").split(","):
        path, _, name = part.strip().partition("=")
        if path:
            found[path.strip()] = name.strip() or None
    return found


def _search(
    given: Any, starts: int, spread: float, held_out: int, evaluations: int, seed: int, checkpoint: Path | None,
    say: Callable[[str], None],
) -> tuple[Any, Any]:  # fmt: skip
    """Run the search, kept in a checkpoint if one is named, and judge where it ended."""
    import jax
    import numpy as np

    from jaxest import parallel, tuning
    from jaxest.cli import tuned
    from jaxest.io import pieces

    batch = tuning.padded(given.recordings)
    count = len(given.recordings) - held_out
    parts = tuning.take(batch, slice(0, count)), tuning.take(batch, slice(count, None)) if held_out else None
    problem = tuning.Problem(given.objective, given.space, windows=given.windows)
    draw, key = jax.random.split(jax.random.key(seed))
    points = tuning.disperse(given.space, starts, key=draw, spread=spread, dtype=given.dtype)
    search = tuning.begin(problem, given.method, points)
    mark = _mark(given, points, seed, parts)
    leads = jax.process_index() == 0
    if checkpoint is not None and leads and checkpoint.exists():
        search = pieces.load(checkpoint, search, mark)
    search = parallel.from_first(search)

    def keep(search: Any) -> None:
        if checkpoint is not None and leads:
            pieces.save(checkpoint, search, mark, overwrite=True)

    def progress(line: str) -> None:
        say(f"{line} {given.unit}" if given.scale == 1 else _scaled(line, given))

    noisy = given.objective.random
    again = "start all again" if checkpoint is None else f"start all again, {checkpoint} has the search so far"
    with parallel.together(f"in the search; {again}"):
        found = tuning.minimise(
            problem, parts[0], method=given.method, search=search, held_out=parts[1], evaluations=evaluations,
            key=key if noisy or given.windows else None, over=parallel.several() if starts > 1 else None,
            progress=progress, keep=keep,
        )  # fmt: skip
    if not np.isfinite(found.values).any():
        raise bad_input(
            f"{given.label}: not finite from any of {starts} start(s), expected one; begin elsewhere (--config)"
        )
    say("standard errors ...")
    return found, tuned.judge(given, points[0], found.point, parts, jax.random.fold_in(key, evaluations))


def _mark(given: Any, points: Any, seed: int, parts: Any) -> int:
    """The checksum of all that a search's numbers depend on."""
    from jaxest.io import pieces

    code = pieces.code((*pieces.ESTIMATE, "tuning", "cli/methods", "cli/tunable"))
    # Off the start, where all free leaves have moved, each as its constraint has it; the others are frozen.
    params = given.space.unpack(points[0] + 1)
    return pieces.fingerprint((code, given.identity, given.windows, params, points, seed, parts))


def _scaled(line: str, given: Any) -> str:
    words, _, value = line.rpartition(" ")
    return f"{words} {float(value) * given.scale:.5g} {given.unit}"
