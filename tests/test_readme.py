"""The README's example runs as it stands there, and commands in README and documentation exist."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer.main

from jaxest import reproduce
from jaxest.cli import settings
from jaxest.cli.app import app
from jaxest.cli.methods import METHODS, deflection_config

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = [
    README,
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "notebooks").glob("*.ipynb")),
]


def test_the_python_example_runs(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)
    time = np.arange(300) / 100
    still = np.tile([0.0, 0.0, 0.01], (300, 1))
    arrays = {
        "time": time,
        "gyr": still,
        "acc": np.add(still, [0, 0, 9.8]),
        "mag": np.tile([0.0, 18.0, -41.0], (300, 1)),
    }
    np.savez(tmp_path / "trial.npz", **arrays)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert len(re.findall(r"-?\d\.\d+", done.stdout)) >= 4 + 9


def test_configs_in_the_documentation_are_taken(tmp_path):
    blocks = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "config.md").read_text(), flags=re.DOTALL)
    for number, text in enumerate(blocks):
        (tmp_path / f"{number}.toml").write_text(text)
    found = [settings.load(tmp_path / f"{number}.toml").tables for number in range(len(blocks))]
    assert {method for tables in found for method in tables} == set(METHODS)
    described = [deflection_config.sensors(tables["deflection"]) for tables in found if "deflection" in tables]
    assert [len(sensors) for sensors in described] == [3]


def commands(page):
    """Words of every `jaxest COMMAND ...` in code of a page, without comments, and of `--part ...` that goes on."""
    for line in re.findall(r"`([^`\n]+)`", page) + re.findall(
        r"^(jaxest .*|srun .*jaxest .*)$", page, flags=re.MULTILINE
    ):
        words = shlex.split(line.partition("jaxest ")[2] or line, comments=True)
        if "jaxest " in line or words[:1] == ["--part"]:
            yield words


def check(command, words):
    """Let a command read its words, without running: an unknown option raises, what it needs must be there.

    Without its arguments a command is only spoken of, and needs nothing.
    """
    given, left, _ = command.make_parser(command.context_class(command)).parse_args([*words])
    there = {name for name, value in given.items() if value}
    assert not left, words
    if any(entry.param_type_name == "argument" and entry.name in there for entry in command.params):
        assert {entry.name for entry in command.params if entry.required} <= there, words


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["log.npz", "--config", "tuned.toml"], "'method'"),
        (["log.npz", "-m", "orientation", "--gain", "1"], "No such option: --gain"),
        (["log.npz", "other.npz", "-m", "orientation"], r"not \['other.npz'\]"),
    ],
    ids=["required option", "unknown option", "one argument too many"],
)
def test_a_command_that_would_fail_is_found(words, said):
    with pytest.raises(Exception, match=said):
        check(typer.main.get_command(app).commands["estimate"], words)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_documentation_exist(page):
    known = typer.main.get_command(app).commands
    paper = ""
    for words in commands(page.read_text()):
        if words[0] in known:
            check(known[words[0]], words[1:])
        if words[0] == "reproduce" and words[1] in reproduce.PAPERS:
            paper = words[1]
        parts = [words[i + 1] for i, word in enumerate(words) if word == "--part"]
        if parts:
            assert set(parts) <= set(reproduce.parts(paper)), words


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_scripts_in_the_documentation_exist(page):
    for script in re.findall(r"python (benchmarks/\w+\.py)", page.read_text()):
        assert (ROOT / script).is_file(), script
