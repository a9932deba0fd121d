"""Where the command line keeps compiled programs."""

import os
from pathlib import Path

import pytest

from jaxest.cli import CACHE, keep_programs


@pytest.fixture
def environment(monkeypatch):
    """The process's environment, put back afterwards."""
    before = dict(os.environ)
    monkeypatch.delenv(CACHE, raising=False)
    yield os.environ
    os.environ.clear()
    os.environ.update(before)


def test_programs_are_kept_in_the_users_cache(environment, tmp_path):
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    keep_programs()
    assert Path(environment[CACHE]).name == "programs"
    assert "jaxest" in environment[CACHE]


@pytest.mark.parametrize("folder", ["", "elsewhere"])
def test_a_persons_own_choice_stays(environment, folder):
    environment[CACHE] = folder
    keep_programs()
    assert environment[CACHE] == folder
