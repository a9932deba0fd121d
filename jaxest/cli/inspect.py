"""`jaxest inspect`: what is in a file, robot or log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from jaxest.cli.output import Answer, Json, Verbose, bad_input, command, console, json_object, note

if TYPE_CHECKING:
    from jaxest.io import Proposal

NAME = "inspect"
EXAMPLES = (
    "jaxest inspect panda.xml",
    "jaxest inspect trial.npz",
    "jaxest inspect log.csv --config config.toml --json",
)
ROBOTS = (".xml", ".mjcf", ".urdf")
NOTHING = "# nothing needs to be said about this log\n"  # so that the lines can be pasted in any case


@command
def run(
    file: Annotated[Path, typer.Argument(help="A robot (MJCF or URDF) or a log (NPZ, CSV, Parquet, HDF5, bag).")],
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Config whose \\[columns] the log is read by.")
    ] = None,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Show a robot's tree, joints, frames and limits, or a log's streams, rates, gaps, clocks and doubtful units.

    For a log in somebody else's layout, the lines of a config that read it are printed too; for a robot, and for a log
    of joints and sensors on links, a first config of the deflection filter.
    """
    del verbose
    return _robot(file, json) if is_robot(file) else _log(file, config, json)


def is_robot(file: Path) -> bool:
    """Tell a robot from a log by the suffix.

    Args:
        file: the file.

    Returns:
        Whether it is a robot.

    Raises:
        InputError: no such file, or it is neither.
    """
    from jaxest.files import existing
    from jaxest.io.formats import FORMATS, is_log_folder

    if is_log_folder(file):
        return False
    existing(file)
    suffix = file.suffix.lower()
    if suffix not in (*ROBOTS, *FORMATS):
        raise bad_input(f"{file}: neither a robot ({', '.join(ROBOTS)}) nor a log ({', '.join(FORMATS)})")
    return suffix in ROBOTS


def _robot(file: Path, json: bool) -> Answer:
    from jaxest.cli import log_view, robot_view
    from jaxest.cli.methods import deflection_config
    from jaxest.io.report import Row, report
    from jaxest.kinematics import load

    robot = load(file)
    facts = robot_view.describe(robot)
    led = {robot.joint_names[joint] for joint, _ in robot.topology.couplings}
    kinds = {joint["name"]: joint["kind"] for joint in facts["joints"] if joint["name"] not in led}
    text = deflection_config.of_robot(kinds, facts["frames"])
    if not json:
        out = console()
        robot_view.show(facts, robot_view.sites_of(robot), out)
        if facts["joints"]:
            out.print(
                "\nA first config for `jaxest estimate LOG --method deflection --robot`, to edit:\n", markup=False
            )
            log_view.show_config(text, out)
        return Answer()
    figures = (("nq", robot.nq, "1"), ("nv", robot.nv, "1"), ("mass", facts["mass_kg"], "kg"),
               ("bodies", len(facts["bodies"]), "1"), ("joints", len(facts["joints"]), "1"),
               ("frames", len(facts["frames"]), "1"))  # fmt: skip
    rows = [Row(metric, facts["name"], float(value), unit) for metric, value, unit in figures]
    return Answer(json_object(report(NAME, rows), robot=facts, config=text))


def _log(file: Path, config: Path | None, json: bool) -> Answer:
    from jaxest.cli import log_view, settings
    from jaxest.cli.methods import onsite_config
    from jaxest.cli.methods.deflection_config import of_log
    from jaxest.cli.methods.orientation import imus
    from jaxest.io import read, to_toml
    from jaxest.io.inspect import summarize
    from jaxest.io.report import report
    from jaxest.types import InputError

    columns = settings.load(config).columns
    proposal = None if columns else _proposal(file)
    text, unsure = (to_toml(proposal), proposal.unsure) if proposal else ("", ())
    try:
        log = read(file, proposal.table if proposal else columns)
        summary = summarize(log)
        text = log_view.with_settings(text, summary, imus(log), of_log(log), onsite_config.of_log(imus(log)))
    except InputError as error:
        if not unsure and text:
            raise InputError(f"{error}; to mend it, put lines such as these into a config:\n{text}") from error
        if not unsure:
            raise
        summary = None  # what is open, such as the sampling rate, is needed to read it at all
    if json:
        notes = list(proposal.assumed if proposal else log.notes)
        found = report(NAME, log_view.rows(summary) if summary else [])
        plain = log_view.plain(summary) if summary else {}
        return Answer(json_object(found, config=text or NOTHING, open=list(unsure), notes=notes, **plain))
    out = console()
    if summary:
        log_view.show(summary, str(file), out)
    for line in () if proposal else log.notes:
        note(line)
    if not text:
        return Answer()
    what = "only you can settle what is open; p" if unsure else "read by this guess; p" if proposal else "P"
    out.print(f"\n{what}ut the right lines into a config:\n")
    log_view.show_config(text, out)
    return Answer()


def _proposal(file: Path) -> "Proposal | None":
    """The guess at somebody else's layout; None for our own, and for what `read` will refuse."""
    from jaxest.io import propose
    from jaxest.types import InputError

    try:
        return propose(file)
    except InputError:
        return None
