"""What commands write: tables for people, one JSON object for programs, one line for an error.

Consoles are made when they are used, so that a redirected stream is honoured; colours and progress bars appear on a
terminal only.
"""

import contextlib
import functools
import json
import math
import os
import re
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TextIO

import typer
from rich.console import Console
from rich.markup import escape

_GUIDED = re.compile(
    r"did you mean|expected|pip install|pass --|overwrite=|into a config|Say in a config|choose another|set MUJOCO_GL|"
    r"partial=True|clock='bag'|expand it first|no such file"
)
"""Words of messages that say what to do."""
DONE, BAD_INPUT, REJECTED = 0, 2, 3
PATIENCE = 30.0  # s between lines of progress where standard error is no terminal
PIPE_WIDTH = 140  # columns of a table that goes to a file or a pipe

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output, nothing else there.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Show where an error in the input was noticed.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite what is there.")]


class Answer(NamedTuple):
    """How a command ended."""

    json: str = ""
    """the object for standard output; empty where a table was printed"""
    status: int = DONE
    """`DONE`, or `REJECTED` where the run finished and its result must not be used"""


def console(stream: TextIO | None = None) -> Console:
    """Make a console on a stream, standard output unless said."""
    stream = stream or sys.stdout
    return Console(file=stream, highlight=False, width=None if stream.isatty() else PIPE_WIDTH)


def note(text: str) -> None:
    """Print a dim line on standard error."""
    err = console(sys.stderr)
    err.print(f"[dim]{escape(text)}[/]", soft_wrap=not err.is_terminal)


def warn(text: str) -> None:
    """Print a warning on standard error."""
    console(sys.stderr).print(f"[yellow]warning:[/] {escape(text)}", soft_wrap=True)


def command(body: Callable[..., Answer]) -> Callable[..., None]:
    """Make a function a command: bad input ends in one line and status 2, `--json` keeps standard output to itself.

    Args:
        body: the command; `verbose` and `json` among its options are looked at here.

    Returns:
        The function to register. InputError and OSError are bad input; everything else is a bug and keeps its
        traceback.
    """

    @functools.wraps(body)
    def guarded(*args: Any, **options: Any) -> None:
        quiet = contextlib.redirect_stdout(sys.stderr) if options.get("json") else contextlib.nullcontext()
        try:
            with quiet:  # some libraries print while they are imported
                answer = body(*args, **options)
            if answer.json:
                sys.stdout.write(answer.json + "\n")
            sys.stdout.flush()
        except (BrokenPipeError, SystemExit) as left:  # the reader has seen enough, as `head` does
            if isinstance(left, SystemExit) and not isinstance(left.__context__, BrokenPipeError):
                raise  # rich makes a SystemExit of a broken pipe; any other is the command's own
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(DONE) from None
        except Exception as error:
            if not _is_bad_input(error):
                raise
            if options.get("verbose") or os.environ.get("JAXEST_DEBUG"):
                traceback.print_exc()
            message = _plain(error)
            further = next_step(message, body.__module__.rpartition(".")[2], options)
            console(sys.stderr).print(f"[bold red]error:[/] {escape(message + further)}", soft_wrap=True)
            raise typer.Exit(BAD_INPUT) from None
        if answer.status:
            raise typer.Exit(answer.status)

    return guarded


def json_object(report: Any, **more: Any) -> str:
    """Write a report with further fields as one JSON object.

    Args:
        report: a `jaxest.io.report.Report`.
        more: fields of plain Python data; numbers that are not finite become null.

    Returns:
        Valid JSON.
    """
    from jaxest.io.report import to_json

    return json.dumps({**json.loads(to_json(report)), **_finite(more)}, indent=2, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@contextlib.contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show on standard error that something of unknown length runs: a spinner on a terminal, else a line now and then.

    Args:
        what: shown beside it.

    Yields:
        A function that changes what is shown.
    """
    err = console(sys.stderr)
    if not err.is_terminal:
        with _lines(what, sys.stderr) as tell:
            yield tell
        return
    with err.status(escape(what)) as status:
        yield lambda message: status.update(escape(message))


@contextlib.contextmanager
def _lines(what: str, stream: TextIO) -> Iterator[Callable[[str], None]]:
    """Write a plain line with the time gone after each `PATIENCE`: for a log or a pipe, which has no spinner."""
    begun, done, latest = time.monotonic(), threading.Event(), [what]

    def tell() -> None:
        while not done.wait(PATIENCE):
            with contextlib.suppress(OSError, ValueError):  # who read it has gone
                stream.write(f"{time.monotonic() - begun:.0f} s: {latest[-1]}\n")
                stream.flush()

    thread = threading.Thread(target=tell, daemon=True)
    thread.start()
    try:
        yield lambda message: latest.append(message)
    finally:
        done.set()
        thread.join()


def bad_input(message: str) -> Exception:
    """Make the error for bad input; `jaxest.types` and with it JAX are loaded for it only now."""
    from jaxest.types import InputError

    return InputError(message)


def next_step(message: str, name: str, options: Mapping[str, Any]) -> str:
    """Say what a person may do about an error whose message does not say it.

    Args:
        message: of the error.
        name: of the command.
        options: the command's own, in which a file that the message is about may be.

    Returns:
        What to type next, to be added to the message; empty where the message has it.
    """
    if _GUIDED.search(message):
        return ""
    for value in options.values():
        if isinstance(value, Path) and message.startswith(str(value)) and value.is_file() and _inspected(value, name):
            return f"; `jaxest inspect {value}` shows what is in it"
    return f"; `jaxest {name} --help` has the options and examples"


def _inspected(path: Path, name: str) -> bool:
    return name != "inspect" and path.suffix != ".toml"


def _is_bad_input(error: Exception) -> bool:
    from jaxest.types import InputError

    return isinstance(error, InputError | OSError)


def _plain(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)
