"""Documentation site: `pip install -e '.[docs]' && sphinx-build docs OUT`; needs no network."""

import importlib
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import jaxest

project, author, release = "jaxest", "the jaxest developers", jaxest.__version__
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "myst_nb"]
exclude_patterns = ["_build", "config_keys.md"]
html_theme = "furo"
html_title = "jaxest"
nb_execution_mode = "off"  # notebooks carry their results; tests run them
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = True
napoleon_use_rtype = False  # shapes before a colon are no types to link to
suppress_warnings = ["myst.header", "mystnb.unknown_mime_type", "misc.highlighting_failure"]
suppress_warnings += ["ref.python"]  # a name that several modules have, as Row

# Sphinx reads below its own folder only, so that what notebooks link to lies elsewhere.
here = Path(__file__).parent
shutil.copytree(here.parent / "notebooks", here / "notebooks", dirs_exist_ok=True)
for book in (here / "notebooks").glob("*.ipynb"):
    book.write_text(book.read_text(encoding="utf-8").replace("](../docs/", "](../"), encoding="utf-8")


def messages() -> None:
    """Write the page of all messages about bad input."""
    sys.path.insert(0, str(here.parent / "tests"))
    from error_messages import messages as found

    rows = [f"| `{m.place}` | {m.text.replace('|', chr(92) + '|').replace(chr(10), ' ')} |" for m in found()]
    head = ["# Messages", "", "What is said of bad input; `{...}` is filled in.", "", "| where | what |", "|---|---|"]
    (here / "messages.md").write_text("\n".join([*head, *rows]) + "\n")


def keys() -> None:
    """Write the table of all keys of a config."""
    from jaxest.cli.methods import METHODS

    words = {str: "text", int: "whole number", float: "number", bool: "true or false", list: "list"}
    rows = ["| table | key | takes |", "|---|---|---|"]

    def walk(table: str, schema: Any) -> None:
        for key, kind in schema.items():
            if isinstance(kind, dict):
                walk(f"{table}.{key.replace('*', 'NAME')}", kind)
            else:
                takes = dict.fromkeys(words[one] for one in (kind if isinstance(kind, tuple) else (kind,)))
                rows.append(f"| `[{table}]` | `{key.replace('*', 'NAME')}` | {', '.join(takes)} |")

    for method, module in METHODS.items():
        walk(method, importlib.import_module(module).schema())
    (here / "config_keys.md").write_text("\n".join(rows) + "\n")


CODE = re.compile(r"(``[^`]*``|`(?:[^`\n]|\n(?!\s*\n))*`)")
STAR = re.compile(r"^(\s*\* )|[*|]", re.MULTILINE)
fields: dict[str, list[str]] = {}


def escaped(star: re.Match[str]) -> str:
    """A star or bar that means itself; one that opens an entry of a list stays."""
    return star[1] or f"\\{star[0]}"


def as_markdown(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Take single backticks in docstrings for code, and stars and bars for what they are."""
    del app, thing, options
    parts = [p if i % 2 else STAR.sub(escaped, p) for i, p in enumerate(CODE.split("\n".join(lines)))]
    for i in range(1, len(parts), 2):
        parts[i] = parts[i] if parts[i].startswith("``") else f"`{parts[i]}`"
        if re.match(r"\w", parts[i + 1]):  # reStructuredText ends code at a blank only
            parts[i + 1] = "\\ " + parts[i + 1]
    lines[:] = "".join(parts).split("\n")
    if what == "attribute":  # napoleon takes what stands before a colon for a type
        fields[name] = lines[:]
        lines.clear()


def with_fields(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Put back what napoleon must not see."""
    del app, what, thing, options
    lines[:] = fields.pop(name, lines)


def setup(app: Any) -> None:
    """Connect before and after napoleon, which reads the sections."""
    app.connect("autodoc-process-docstring", as_markdown, priority=400)
    app.connect("autodoc-process-docstring", with_fields, priority=600)


messages()
keys()
