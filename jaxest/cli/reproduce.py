"""`jaxest reproduce`: a paper's figures and tables, computed anew."""

import importlib.util
import time
from pathlib import Path
from typing import Annotated

import typer

from jaxest.cli.devices import Devices
from jaxest.cli.output import Answer, Force, Json, Verbose, bad_input, command, console, json_object, note, working

NAME = "reproduce"
EXAMPLES = (
    "jaxest reproduce sato2023",
    "jaxest reproduce sato2023 --part fig6 --part fig10 -o pictures",
    "jaxest reproduce sato2023 --json > sato2023.json",
    "jaxest reproduce zakeri2023 --part table1 --devices 2",
)


@command
def run(
    paper: Annotated[str, typer.Argument(help="The paper, as in sato2023.")],
    part: Annotated[
        list[str] | None, typer.Option("--part", help="Only this figure; may be given several times.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the pictures; none without it.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of all that is random.")] = 0,
    small: Annotated[
        bool, typer.Option("--small", help="Tiny sizes, to see that it runs; the figures mean nothing.")
    ] = False,
    runs: Annotated[int | None, typer.Option(help="Monte-Carlo runs of each condition.")] = None,
    row: Annotated[
        list[str] | None, typer.Option("--rows", help="Only this row of the table; may be given several times.")
    ] = None,
    setting: Annotated[str | None, typer.Option(help="One of the paper's data settings.")] = None,
    broad: Annotated[Path | None, typer.Option(help="Folder with the BROAD trials, to measure on them too.")] = None,
    work: Annotated[
        Path | None, typer.Option(help="Folder that keeps finished runs; the same command goes on from there.")
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="Name the parts and leave.")] = False,
    devices: Devices = None,
    force: Force = False,
    json: Json = False,
    verbose: Verbose = False,
) -> Answer:
    """Compute a paper's figures anew: tables here, pictures like the paper's into a folder."""
    del verbose, devices
    from jaxest import reproduce
    from jaxest.cli.tables import figures
    from jaxest.io.report import Row, report, to_json

    known = list(reproduce.parts(paper))
    if show and json:
        return Answer(json_object(report(paper, []), parts=known))
    if show:
        console().print("\n".join(known))
        return Answer()
    choice = reproduce.Choice(seed, small, runs, tuple(row or ()), setting, broad, work)
    names = tuple(part or reproduce.possible(paper, choice))
    folder = _folder(out, [f"{name}.png" for name in names], force) if out else None
    rows: list[Row] = []
    drawn: list[str] = []
    begun = time.perf_counter()
    with working(f"{paper} ...") as say:
        for section in reproduce.sections(paper, names, choice=choice, say=say):
            rows += [row._replace(metric=f"{section.name}: {row.metric}") for row in section.rows]
            if folder and section.draw:
                folder.mkdir(parents=True, exist_ok=True)
                section.draw(folder / f"{section.name}.png")
                drawn.append(section.name)
            if not json:
                console().print(figures(section.rows, section.title) if section.rows else f"{section.title}\n")
    rows.append(Row("run time", "compilation included", time.perf_counter() - begun, "s"))
    if json:
        return Answer(to_json(report(paper, rows)))
    note(f"{paper}: {len(names)} parts in {rows[-1].value:.0f} s" + (f"; pictures in {folder}" if drawn else ""))
    bare = [name for name in names if folder and name not in drawn]
    if bare:
        note(f"no picture of {', '.join(bare)}: figures only")
    left = [name for name in known if not part and name not in names]
    if left:
        note(f"left out, without the folder that it needs: {', '.join(left)}; `--part {left[0]}` says which")
    return Answer()


def _folder(out: Path, names: list[str], force: bool) -> Path:
    """The folder for the pictures, checked before anything is computed."""
    if not importlib.util.find_spec("matplotlib"):
        raise bad_input("pictures need matplotlib: pip install 'jaxest[viz]', or leave out --out")
    if out.exists() and not out.is_dir():
        raise bad_input(f"{out}: is a file, expected a folder to write into")
    there = [name for name in names if (out / name).exists()]
    if there and not force:
        raise bad_input(f"{out}: {', '.join(there)} exists already and is kept; pass --force to replace it")
    return out
