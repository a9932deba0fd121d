"""How a command leaves: a reader that has gone is no failure, a status of the command's own is kept."""

import os

import pytest
import typer
from rich.console import Console

from jaxest.cli import output


def test_a_status_of_its_own_is_kept():
    def body():
        raise SystemExit(3)

    with pytest.raises(SystemExit) as left:
        output.command(body)()
    assert left.value.code == 3


def test_a_reader_that_has_gone_is_no_failure(monkeypatch, tmp_path):
    """Rich makes a SystemExit with status 1 of it."""
    with (tmp_path / "stand-in").open("w") as out:  # in place of the true standard output, which ends in nothing then
        monkeypatch.setattr("sys.stdout", out)

        def body():
            read, write = os.pipe()
            os.close(read)
            with os.fdopen(write, "w") as pipe:
                Console(file=pipe).print("line")
                pipe.flush()

        with pytest.raises(typer.Exit) as left:
            output.command(body)()
    assert left.value.exit_code == output.DONE
