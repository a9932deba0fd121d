"""Documentation site: `pip install -e '.[docs]' && sphinx-build docs OUT`; needs no network."""

import re
import shutil
import sys
from pathlib import Path
from typing import Any

import jaxest

project, author, release = "jaxest", "the jaxest developers", jaxest.__version__
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "myst_nb"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "jaxest"
nb_execution_mode = "off"  # notebooks carry their results; tests run them
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = True
suppress_warnings = ["myst.header", "mystnb.unknown_mime_type", "misc.highlighting_failure"]

# Sphinx reads below its own folder only.
here = Path(__file__).parent
shutil.copytree(here.parent / "notebooks", here / "notebooks", dirs_exist_ok=True)


def messages() -> None:
    """Write the page of all messages about bad input."""
    sys.path.insert(0, str(here.parent / "tests"))
    from error_messages import messages as found

    rows = [f"| `{m.place}` | {m.text.replace('|', chr(92) + '|').replace(chr(10), ' ')} |" for m in found()]
    head = ["# Messages", "", "What is said of bad input; `{...}` is filled in.", "", "| where | what |", "|---|---|"]
    (here / "messages.md").write_text("\n".join([*head, *rows]) + "\n")


def as_markdown(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Take single backticks in docstrings for code, and stars and bars for what they are."""
    del app, what, name, thing, options
    for i, line in enumerate(lines):
        parts = re.split(r"(``[^`]*``|`[^`]*`)", line)
        lines[i] = "".join(
            (p if p.startswith("``") else f"`{p}`") if p.startswith("`") else re.sub(r"([*|])", r"\\\1", p)
            for p in parts
        )


def setup(app: Any) -> None:
    """Connect before napoleon, which reads the sections."""
    app.connect("autodoc-process-docstring", as_markdown, priority=400)


messages()
