"""The application: its help and its commands, each of which lives in a file of its own."""

import logging
from typing import Annotated

import typer

import jaxest
from jaxest.cli import bench, compare, demo, doctor, estimate, inspect, reproduce, show, tune

EPILOG = (
    "Start with [bold]jaxest demo[/], then [bold]jaxest inspect[/] a robot (MJCF, URDF) or a log (NPZ, CSV, ...) of "
    "yours.\n\n"
    "jaxest inspect my_robot.urdf\n\n"
    "jaxest inspect log.csv\n\n"
    "jaxest estimate log.csv --method orientation --config log.toml -o out\n\n"
    "jaxest reproduce santaera2015 --part table1 -o pictures\n\n"
    "[bold]jaxest COMMAND --help[/] has examples of each. "
    "Exit status: 0 done, 2 bad input, 3 finished but the result must not be used."
)

app = typer.Typer(
    name="jaxest",
    help="Estimates a robot's own body from its own sensors.",
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"jaxest {jaxest.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Estimates a robot's own body from its own sensors."""
    logging.getLogger("jaxest").addHandler(logging.NullHandler())  # commands print a robot's notes themselves


for module in (demo, inspect, estimate, show, compare, tune, reproduce, bench, doctor):
    app.command(module.NAME, epilog="\n\n".join(("Examples:", *module.EXAMPLES)))(module.run)
