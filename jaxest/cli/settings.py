"""The config of a command: how to read the log, what to do with NaN, and each method's own table."""

import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxest.types import InputError, unknown_name

NAN = ("error", "missing")


class Settings(NamedTuple):
    """A config, checked."""

    columns: Mapping[str, Any] | None = None
    """`[columns]`, or None"""
    nan: str = NAN[0]
    tables: Mapping[str, Any] = {}

    def method(self, name: str) -> Mapping[str, Any]:
        """Return the table of a method, empty if there is none."""
        return self.tables.get(name, {})


def load(path: Path | None) -> Settings:
    """Read a config; every method's table is checked, also of methods that do not run now.

    Args:
        path: a TOML file; None for the defaults.

    Returns:
        The settings.

    Raises:
        InputError: no such file, not TOML, an unknown key or a wrong type; file and line are named.
    """
    from jaxest.cli.methods import METHODS
    from jaxest.io.config import read_config

    if path is None:
        return Settings()
    schema = {name: importlib.import_module(module).schema() for name, module in METHODS.items()}
    data = read_config(path, {"nan": str, **schema})
    nan = data.get("nan", NAN[0])
    if nan not in NAN:
        raise InputError(f"{path}: nan: {unknown_name('choice', nan, NAN)}")
    return Settings(data.get("columns"), nan, {name: data[name] for name in METHODS if name in data})
