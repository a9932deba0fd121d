"""The public names are those of `public_api.txt`: whoever adds or takes away one says so there.

`python tests/test_public_api.py` writes the list anew.
"""

import importlib
import re
import tomllib
from pathlib import Path
from types import ModuleType

import jaxest

LIST = Path(__file__).parent / "public_api.txt"


def public() -> list[str]:
    """Every name in `__all__` of the package, its subpackages, and the modules that these name."""
    found: set[str] = set()
    waiting = [importlib.import_module(f"jaxest.{name}") for name in jaxest.__all__ if not name.startswith("_")]
    seen: set[str] = set()
    while waiting:
        module = waiting.pop()
        if module.__name__ in seen:
            continue
        seen.add(module.__name__)
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if isinstance(thing, ModuleType) and thing.__name__.startswith("jaxest."):
                waiting.append(thing)
            else:
                found.add(f"{module.__name__}.{name}")
    return sorted(found)


def test_public_names_are_those_that_were_agreed():
    agreed = LIST.read_text().split()
    now = public()
    assert sorted(set(agreed) - set(now)) == [], "public names that are gone; keep an alias for one release"
    assert sorted(set(now) - set(agreed)) == [], "public names that are new; add them to public_api.txt"


def test_every_public_module_has_its_place_in_the_reference():
    pages = "\n".join(page.read_text() for page in (Path(__file__).parents[1] / "docs" / "api").glob("*.md"))
    shown = set(re.findall(r"automodule:: (\S+)", pages))
    assert sorted({name.rpartition(".")[0] for name in LIST.read_text().split()} - shown) == []


def test_the_version_is_one_and_told_in_the_changes():
    root = Path(__file__).parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    assert project["version"] == jaxest.__version__
    assert f"## {jaxest.__version__} (" in (root / "CHANGELOG.md").read_text()


if __name__ == "__main__":
    LIST.write_text("\n".join(public()) + "\n")
