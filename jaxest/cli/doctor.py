"""`jaxest doctor`: what is installed, what it runs on, what is missing."""

import importlib.metadata
import os
import platform
import re
from typing import Any, NamedTuple

from rich.table import Table

from jaxest.cli.output import Answer, Json, Verbose, command, console

NAME = "doctor"
EXAMPLES = ("jaxest doctor", "jaxest doctor --json")
CORE = ("jax", "jaxlib", "numpy", "mujoco", "mujoco-mjx", "optax", "typer", "rich")


class Requirement(NamedTuple):
    """A line of the project's dependencies."""

    package: str
    range: str
    extra: str


class Package(NamedTuple):
    """What is there of a package."""

    package: str
    installed: str | None
    tested: str
    extra: str
    verdict: str


@command
def run(json: Json = False, verbose: Verbose = False) -> Answer:
    """Show versions, devices and settings, and the line that installs what is missing."""
    del verbose
    facts = examine()
    if json:
        import json as text

        return Answer(text.dumps(facts, indent=1))
    _print(facts)
    return Answer()


def examine() -> dict[str, Any]:
    """Gather what there is to say.

    Returns:
        Packages (version, tested range, verdict), devices, XLA flags, compilation cache, processors, missing extras.
    """
    import jax

    from jaxest.io.report import environment

    packages = [_package(one) for one in _requirements()]
    missing = sorted({one.extra for one in packages if one.extra not in ("", "dev") and not one.installed})
    return {
        "name": "doctor",
        **environment()._asdict(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpus": os.cpu_count(),
        "backend": jax.default_backend(),
        "x64": bool(jax.config.values["jax_enable_x64"]),
        "compilation_cache": jax.config.values["jax_compilation_cache_dir"],
        "packages": [one._asdict() for one in packages],
        "missing": {extra: f"pip install 'jaxest[{extra}]'" for extra in missing},
        "rows": [],
    }


def satisfies(version: str, wanted: str) -> bool:
    """Tell whether a version lies in a range.

    Args:
        version: for example `"0.10.2"`.
        wanted: comma-separated bounds with `>=`, `<=`, `==`, `!=`, `>` or `<`; empty accepts everything.

    Returns:
        The answer, comparing the numbers of the versions (a suffix such as `rc1` is not looked at).
    """
    have = _numbers(version)
    for sign, bound in re.findall(r"(>=|<=|==|!=|>|<)\s*([\w.]+)", wanted):
        want = _numbers(bound)
        width = max(len(have), len(want))
        a, b = have + (0,) * (width - len(have)), want + (0,) * (width - len(want))
        if not {">=": a >= b, "<=": a <= b, "==": a == b, "!=": a != b, ">": a > b, "<": a < b}[sign]:
            return False
    return True


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.match(r"[\d.]*", version).group().split(".") if part)  # type: ignore[union-attr]


def _requirements() -> list[Requirement]:
    try:
        lines = importlib.metadata.requires("jaxest") or []
    except importlib.metadata.PackageNotFoundError:
        return [Requirement(name, "", "") for name in CORE]
    found = [_requirement(line) for line in lines]
    named = {one.package for one in found}
    return [*(Requirement(name, "", "") for name in CORE if name not in named), *found]


def _requirement(line: str) -> Requirement:
    what, _, marker = line.partition(";")
    package = re.match(r"[\w.-]+", what.strip()).group()  # type: ignore[union-attr]
    extra = re.search(r"extra\s*==\s*['\"](\w+)", marker)
    return Requirement(package, what.strip()[len(package) :].strip(), extra.group(1) if extra else "")


def _package(wanted: Requirement) -> Package:
    try:
        version = importlib.metadata.version(wanted.package)
    except importlib.metadata.PackageNotFoundError:
        return Package(wanted.package, None, wanted.range, wanted.extra, "missing")
    verdict = "ok" if satisfies(version, wanted.range) else "not tested"
    return Package(wanted.package, version, wanted.range, wanted.extra, verdict)


def _print(facts: dict[str, Any]) -> None:
    out = console()
    colour = {"ok": "green", "missing": "yellow", "not tested": "red"}
    table = Table(title=f"jaxest {facts['jaxest']} on Python {facts['python']}", title_justify="left", box=None)
    for name in ("package", "installed", "tested with", "extra", ""):
        table.add_column(name, header_style="bold")
    for one in facts["packages"]:
        if one["extra"] == "dev" or one["package"] == "jaxest":
            continue
        verdict = f"[{colour[one['verdict']]}]{one['verdict']}[/]"
        table.add_row(one["package"], one["installed"] or "-", one["tested"], one["extra"], verdict)
    out.print(table)
    out.print()
    facts_table = Table(box=None, show_header=False)
    facts_table.add_row("devices", ", ".join(facts["devices"]))
    facts_table.add_row("processors", str(facts["cpus"]))
    facts_table.add_row("precision", "64-bit allowed" if facts["x64"] else "32-bit (JAX_ENABLE_X64=1 allows 64-bit)")
    facts_table.add_row("XLA flags", " ".join(facts["flags"]) or "none")
    cache = facts["compilation_cache"]
    facts_table.add_row("compilation cache", cache or "off (JAX_COMPILATION_CACHE_DIR=DIR keeps programs between runs)")
    out.print(facts_table)
    for extra, line in facts["missing"].items():
        out.print(f"[yellow]{extra}[/] is not complete: [bold]{line.replace('[', chr(92) + '[')}[/]")
