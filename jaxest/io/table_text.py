"""A column table as lines to paste into a config."""

import json
from typing import Any

from jaxest.io.columns import Column, ColumnTable
from jaxest.io.proposal import Proposal


def to_toml(table: ColumnTable | Proposal) -> str:
    """Write a column table as lines to paste into a config.

    Args:
        table: a table or a proposal, whose assumptions and open questions become comments.

    Returns:
        TOML text.
    """
    comments: list[str] = []
    if isinstance(table, Proposal):
        comments = [f"# open: {line}" for line in table.unsure] + [f"# {line}" for line in table.assumed]
        table = table.table
    plain = ColumnTable({})
    lines = [*comments, "[columns]"]
    if any(c.time is None and c.rate is None for c in table.streams.values()) and table.time is table.rate is None:
        lines.append("# rate = 100.0  # Hz; put the sampling rate here")
    lines += [f"{k} = {_toml(v)}" for k, v in table._asdict().items() if k != "streams" and v != getattr(plain, k)]
    for name, column in table.streams.items():
        lines += ["", f"[columns.{name if name.isidentifier() and name.isascii() else json.dumps(name)}]"]
        lines += [f"{k} = {_toml(v)}" for k, v in column._asdict().items() if v != Column._field_defaults[k]]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value)
