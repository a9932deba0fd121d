"""`jaxest bench`: how fast it is on this machine, beside other programs."""

from pathlib import Path
from typing import Annotated

import typer

from jaxest.cli.devices import Devices
from jaxest.cli.output import Answer, Json, Verbose, command, console, json_object, working

NAME = "bench"
EXAMPLES = (
    "jaxest bench orientation",
    "jaxest bench kinematics --robot panda.xml",
    "jaxest bench torque --devices 2",
    "jaxest bench --no-peers --json",
)


@command
def run(
    name: Annotated[
        str | None, typer.Argument(help="Case to run; all of them if left out.", show_default=False)
    ] = None,
    peers: Annotated[
        bool, typer.Option("--peers/--no-peers", help="Run other programs beside it, if installed.")
    ] = True,
    small: Annotated[
        bool, typer.Option("--small", help="Tiny sizes, to see that it runs; the figures mean nothing.")
    ] = False,
    robot: Annotated[
        list[Path] | None,
        typer.Option("--robot", help="Another robot to measure (MJCF or URDF); may be given several times."),
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="Name the cases and leave.")] = False,
    devices: Devices = None,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Time jaxest on this machine: medians of warm, blocked runs, peers in turn with them, compile time apart.

    The spread is the interquartile range. A ratio is the median of the rounds' ratios to the peer.
    """
    del verbose, devices
    from jaxest import bench
    from jaxest.cli.tables import figures
    from jaxest.io.report import report, to_json

    out = console()
    if show and json:
        return Answer(json_object(report("bench", []), cases=list(bench.CASES)))
    if show:
        out.print("\n".join(bench.CASES))
        return Answer()
    found = []
    robots = [str(file) for file in robot or ()]
    for case in [name or "kinematics"] if name or robots else bench.CASES:
        with working(f"{case} ...") as say:
            rows = list(bench.rows(case, peers=peers, progress=say, small=small, robots=robots))
        if not json:
            out.print(figures(rows, case, timing=True))
        found += rows
    return Answer(to_json(report("bench", found))) if json else Answer()
