"""Every message that a person may see about bad input, read from the package's source."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jaxest

PACKAGE = Path(jaxest.__file__).parent
RAISED = ("InputError", "bad_input")


class Message(NamedTuple):
    """One place where bad input is refused."""

    place: str
    """File and line."""
    text: str
    """What is said, `{...}` where something is filled in."""


def messages() -> Iterator[Message]:
    """Read all messages of `InputError`s, file by file."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in RAISED and node.args:
                yield Message(f"{path.relative_to(PACKAGE.parent)}:{node.lineno}", _text(node.args[0]))


def _text(node: ast.expr) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        return "{" + ast.unparse(node.value) + "}"
    if isinstance(node, ast.BinOp):
        return _text(node.left) + _text(node.right)
    return "{" + ast.unparse(node) + "}"
