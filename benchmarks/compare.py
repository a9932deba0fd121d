"""What became slower, or less accurate, between two results of `jaxest bench --json` or of a script here.

    python benchmarks/keep.py orientation
    python benchmarks/compare.py OLD.json NEW.json [--tolerance 1.2]

Rows are matched by metric, condition and peer. Where both have that peer, their ratios to it are compared, which the
machine's mood does not move; otherwise the values themselves, if they are times, errors or rates, and the line says so.
What had a value and has none any more is worse. Exit status 1 if anything got worse by more than the tolerance (a
factor).
"""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any, NamedTuple

TIMES = {"s", "ms", "us", "ns"}
ERRORS = {"deg", "rad", "m", "mm", "sd"}
RATES = {"1/s"}
Key = tuple[str, str, str | None]
"""Metric, condition, and the peer whose ratio the row gives."""


class Change(NamedTuple):
    """One row in both results."""

    metric: str
    condition: str
    factor: float
    """How many times worse it is now; below 1, better."""
    how: str
    """What was compared."""


def load(path: Path) -> dict[Key, dict[str, Any]]:
    """Read a result and return its rows by metric, condition and peer."""
    try:
        rows = json.loads(path.read_text())["rows"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"{path}: not a result of `jaxest bench --json` ({error})")
    return {(row["metric"], row["condition"], row.get("reference_name")): row for row in rows}


def changes(old: dict[Key, dict[str, Any]], new: dict[Key, dict[str, Any]]) -> list[Change]:
    """Compare rows that are in both, the worst first; where a peer is gone, with another row of that metric."""
    some = {key[:2]: row for key, row in new.items()}
    found = []
    for key, before in old.items():
        after = new.get(key) or some.get(key[:2])
        if after is not None:
            how = changed(before, after)
            found += [] if how is None else [Change(*key[:2], *how)]
    return sorted(set(found), key=lambda change: -change.factor)


def changed(before: dict[str, Any], after: dict[str, Any]) -> tuple[float, str] | None:
    """How many times worse a row has become, and by what; None where nothing can be compared."""
    if before.get("value") is not None and after.get("value") is None:
        return math.inf, "lost its value"
    if before.get("ratio") and after.get("ratio") and before.get("reference_name") == after.get("reference_name"):
        return before["ratio"] / after["ratio"], f"ratio to {after['reference_name']}"
    unit = after["unit"]
    if before["unit"] != unit or unit not in TIMES | ERRORS | RATES:
        return None
    if not (before.get("value") and after.get("value")):
        return None
    factor = after["value"] / before["value"]
    return (1 / factor if unit in RATES else factor), f"value in {unit}, without a peer"


def main(arguments: list[str]) -> int:
    """Print what changed, and return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--tolerance", type=float, default=1.2)
    options = parser.parse_args(arguments)
    old, new = load(options.old), load(options.new)
    found = changes(old, new)
    for change in found:
        word = (
            "WORSE "
            if change.factor > options.tolerance
            else "better"
            if change.factor * options.tolerance < 1
            else "same  "
        )
        print(f"{word} {change.factor:6.2f}x  {change.metric} | {change.condition} ({change.how})")
    before, after = ({key[:2] for key in rows} for rows in (old, new))
    for name, only in (("only in the old result", before - after), ("new", after - before)):
        for metric, condition in sorted(only):
            print(f"{name}: {metric} | {condition}")
    return int(any(change.factor > options.tolerance for change in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
