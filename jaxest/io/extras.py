"""Packages that only some formats need: imported when such a file is read, named with the line that installs them."""

import importlib
from typing import Any

from jaxest.files import PathLike
from jaxest.types import InputError


def need(module: str, extra: str, path: PathLike) -> Any:
    """Import a module of an optional package.

    Args:
        module: its full name, for example `pyarrow.parquet`.
        extra: the extra of jaxest that installs it.
        path: the file that it is needed for.

    Returns:
        The module.

    Raises:
        InputError: the package is not installed; the message has the line that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise InputError(
            f"{path}: needs {package}, which is not installed: pip install 'jaxest[{extra}]' ({error})"
        ) from error
