"""Config files in TOML, with errors that name the file, the line and the field."""

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from jaxest.files import PathLike, existing, write_text
from jaxest.io import columns
from jaxest.types import InputError, unknown_name

Schema = Mapping[str, Any]
"""Key -> type, tuple of types, `Any`, or a `Schema` of the table below; the key `*` stands for any name."""


def read_config(path: PathLike, schema: Schema | None = None) -> dict[str, Any]:
    """Read a config.

    Args:
        path: a TOML file. Its `[columns]` table, if any, is validated as `jaxest.io.columns` describes.
        schema: what else may be in it, for example `{"method": str, "noise": {"gyro": float}}`; a float takes an
            integer too. None allows everything.

    Returns:
        The tables as `tomllib` reads them; `columns` stays a dict that `read(path, columns)` takes.

    Raises:
        InputError: no such file, not TOML (with its line), an unknown key (closest one named) or a wrong type.
    """
    file = existing(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
        data = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not text; expected TOML in UTF-8") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    rest = {key: value for key, value in data.items() if key != "columns"}
    if "columns" in data:
        place = f"{path}{_line(text, ('columns',))}: columns"
        if not isinstance(data["columns"], dict):
            raise InputError(f"{place}: expected a table")
        columns.parse(data["columns"], place)
    if schema is not None:
        _validate(str(path), text, rest, schema, ())
    return data


def write_config(path: PathLike, tables: Mapping[str, Any], overwrite: bool = False) -> None:
    """Write a config, whole or not at all.

    Args:
        path: where it goes.
        tables: text, truth values, numbers, lists of those, and tables, under keys.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: the output exists or cannot be written.
    """
    write_text(path, _toml(tables, ()).strip("\n") + "\n", overwrite)


def _toml(table: Mapping[str, Any], way: tuple[str, ...]) -> str:
    """A table's own keys, then the tables in it."""
    own = "".join(f"{_key(k)} = {_literal(v)}\n" for k, v in table.items() if not isinstance(v, Mapping))
    head = f"\n[{'.'.join(map(_key, way))}]\n" if way and (own or not table) else ""
    return head + own + "".join(_toml(v, (*way, k)) for k, v in table.items() if isinstance(v, Mapping))


def _key(name: str) -> str:
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name)


def _literal(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_literal, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(k)} = {_literal(v)}' for k, v in value.items())} }}"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def _validate(path: str, text: str, data: Mapping[str, Any], schema: Schema, keys: tuple[str, ...]) -> None:
    for key, value in data.items():
        here = (*keys, key)
        place = f"{path}{_line(text, here)}"
        if key not in schema and "*" not in schema:
            known = [*schema, "columns"] if not keys else list(schema)
            raise InputError(f"{place}: {unknown_name('key', '.'.join(here), ['.'.join((*keys, k)) for k in known])}")
        wanted = schema.get(key, schema.get("*"))
        if isinstance(wanted, Mapping):
            if not isinstance(value, dict):
                raise InputError(f"{place}: {'.'.join(here)} is {value!r}, expected a table")
            _validate(path, text, value, wanted, here)
        elif wanted is not Any:
            _typed(place, ".".join(here), value, wanted if isinstance(wanted, tuple) else (wanted,))


def _typed(place: str, name: str, value: Any, wanted: tuple[type, ...]) -> None:
    allowed = (*wanted, int) if float in wanted else wanted
    if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in wanted):
        expected = " or ".join(t.__name__ for t in wanted)
        raise InputError(f"{place}: {name} is {value!r}, expected {expected}")


def _line(text: str, keys: tuple[str, ...]) -> str:
    """Return `, line N` where a key or table stands in the text, or nothing where it is written in another way."""
    table: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), 1):
        header = re.match(r"\s*\[+\s*([^\]]+?)\s*\]", line)
        if header:
            table = tuple(part.strip().strip("\"'") for part in header.group(1).split("."))
            if table[: len(keys)] == keys:
                return f", line {number}"
            continue
        entry = re.match(r"\s*([\w\-.\"']+)\s*=", line)
        if entry and (*table, *(part.strip("\"'") for part in entry.group(1).split(".")))[: len(keys)] == keys:
            return f", line {number}"
    return ""
