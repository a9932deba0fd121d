"""What became slower, or less accurate, between two results of `jaxest bench --json` or of a script here.

    python benchmarks/keep.py orientation
    python benchmarks/compare.py OLD.json NEW.json [--tolerance 1.2]

Rows are matched by metric and condition. Where both have a peer, their ratios to it are compared, which the machine's
mood does not move; otherwise the values themselves, and the line says so. Exit status 1 if anything got worse by more
than the tolerance (a factor).
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, NamedTuple

TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
ERRORS = {"deg", "rad", "m", "mm"}


class Change(NamedTuple):
    """One row in both results."""

    metric: str
    condition: str
    factor: float
    """How many times worse it is now; below 1, better."""
    how: str
    """What was compared."""


def load(path: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """Read a result and return its rows by metric and condition."""
    try:
        rows = json.loads(path.read_text())["rows"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"{path}: not a result of `jaxest bench --json` ({error})")
    return {(row["metric"], row["condition"]): row for row in rows}


def changes(old: dict[tuple[str, str], dict[str, Any]], new: dict[tuple[str, str], dict[str, Any]]) -> list[Change]:
    """Compare rows that are in both, the worst first."""
    found = []
    for key in old.keys() & new.keys():
        before, after = old[key], new[key]
        if before["unit"] != after["unit"] or before["unit"] not in TIMES.keys() | ERRORS:
            continue
        if before.get("ratio") and after.get("ratio") and before.get("reference_name") == after.get("reference_name"):
            found.append(Change(*key, before["ratio"] / after["ratio"], f"ratio to {after['reference_name']}"))
        elif before.get("value") and after.get("value"):
            found.append(Change(*key, after["value"] / before["value"], f"value in {after['unit']}, without a peer"))
    return sorted(found, key=lambda change: -change.factor)


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
    for name, only in (("only in the old result", old.keys() - new.keys()), ("new", new.keys() - old.keys())):
        for metric, condition in sorted(only):
            print(f"{name}: {metric} | {condition}")
    return int(any(change.factor > options.tolerance for change in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
