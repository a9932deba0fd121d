"""`jaxest compare`: how wrong an estimate is, and whether it knows."""

from pathlib import Path
from typing import Annotated

import typer

from jaxest.cli.output import Answer, Json, Verbose, command, console, note

NAME = "compare"
EXAMPLES = (
    "jaxest compare jaxest-out/estimate.npz trial.npz",
    "jaxest compare mine.csv theirs.npz --config theirs.toml --json",
)


@command
def run(
    estimate: Annotated[Path, typer.Argument(help="Log with the estimate, for example jaxest-out/estimate.npz.")],
    truth: Annotated[Path, typer.Argument(help="Log with the truth; NaN where it is unknown.")],
    stream: Annotated[str, typer.Option("--stream", "-s", help="Name of the orientation, if a log has several.")] = "",
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Config whose \\[columns] the truth is read by.")
    ] = None,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Compare two orientations: errors in degrees as BROAD defines them, NEES and coverage where a covariance is there.

    The truth is interpolated at the times of the estimate. A stream `movement` beside the truth says which samples
    count. If either is without a magnetometer (as `estimate` notes in its output) only the inclination is judged.
    """
    del verbose
    import numpy as np

    from jaxest.cli import orientation_errors, settings
    from jaxest.cli.tables import figures
    from jaxest.cli.truth import at, find, refuse_odd
    from jaxest.io import read
    from jaxest.io.report import report, to_json

    mine = read(estimate)
    theirs = read(truth, settings.load(config).columns)
    for path, log in ((estimate, mine), (truth, theirs)):
        if log.notes:
            note(f"{path.name}: {'; '.join(log.notes)}")
    name = find(mine, stream)
    item = mine.streams[name]
    other = stream if stream in theirs.streams else find(theirs, "")
    refuse_odd(mine, name)
    refuse_odd(theirs._replace(streams={other: theirs.streams[other]}), other)
    movement = theirs.streams.get(other.removesuffix("orientation") + "movement", theirs.streams.get("movement"))
    true, moving = at(theirs, other, movement, item.time)
    known = np.isfinite(item.value).all(axis=-1)
    covariance = mine.streams.get(f"{name}_covariance")
    rows = orientation_errors.rows(
        item.value[known],
        true[known],
        covariance=None if covariance is None else covariance.value[known],
        movement=None if moving is None else moving[known],
        heading=all(one.extra.get("heading") != "free" for one in (item, theirs.streams[other])),
        condition="moving" if moving is not None else "",
        place=str(truth),
    )
    if json:
        return Answer(to_json(report("compare", rows)))
    console().print(figures(rows, f"{estimate} against {truth}"))
    return Answer()
