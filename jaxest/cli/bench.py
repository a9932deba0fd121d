"""`jaxest bench`: how fast it is on this machine, beside other programs."""

from pathlib import Path
from typing import Annotated

import typer

from jaxest.cli.devices import Devices
from jaxest.cli.output import Answer, Json, Verbose, bad_input, command, console, json_object, working

NAME = "bench"
EXAMPLES = (
    "jaxest bench orientation",
    "jaxest bench kinematics --robot panda.xml",
    "jaxest bench torque --devices 2",
    "jaxest bench scaling -o scaling.png",
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
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Picture of the case scaling; replaced if it exists.")
    ] = None,
    peer_seconds: Annotated[
        float | None,
        typer.Option(help="torque: how long each other sampler runs; 30 s if left out.", show_default=False),
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

    page = console()
    if out is not None and name != "scaling":
        raise bad_input(f"--out {out}: only the case scaling has a picture, got {name or 'all cases'}")
    if show and json:
        return Answer(json_object(report("bench", []), cases=list(bench.CASES)))
    if show:
        page.print("\n".join(bench.CASES))
        return Answer()
    found = []
    robots = [str(file) for file in robot or ()]
    for case in [name or "kinematics"] if name or robots else bench.CASES:
        with working(f"{case} ...") as say:
            rows = list(bench.rows(case, peers=peers, progress=say, small=small, robots=robots,
                                   peer_seconds=peer_seconds))  # fmt: skip
        if not json:
            page.print(figures(rows, case, timing=True))
        found += rows
    if out is not None:
        from jaxest.bench import scaling

        scaling.draw(out, found)
    return Answer(to_json(report("bench", found))) if json else Answer()
