"""Run cases of `jaxest bench` and keep their results beside this script, as JSON and as tables to read.

    python benchmarks/keep.py [CASE ...] [--devices 2]

Each case goes to `benchmarks/results/CASE.json`, which `compare.py` reads, and `CASE.md`, a table with the command that
made it. All cases but `live`, which takes its minutes, if none is named.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"


def table(case: str, command: str, report: dict[str, Any]) -> str:
    """Return a result as Markdown."""
    lines = [
        f"# {case}",
        "",
        f"`{command}`, jaxest {report['jaxest']}, JAX {report['jax']}, MuJoCo {report['mujoco']}, "
        f"{', '.join(report['devices'])}. A ratio above 1: so many times faster than the peer, median over rounds.",
        "",
        "| metric | condition | value | spread | n | peer | its value | ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        number = {
            key: "" if row[key] is None else f"{row[key]:.4g}" for key in ("value", "spread", "reference", "ratio")
        }
        lines.append(
            f"| {row['metric']} | {row['condition']} | {number['value']} {row['unit']} | {number['spread']} | "
            f"{row['n'] or ''} | {row['reference_name'] or ''} | {number['reference']} | {number['ratio']} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Run the cases, and return how many failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--devices", type=int, help="as `jaxest bench --devices`")
    given = parser.parse_args(arguments)
    from jaxest.bench import CASES

    RESULTS.mkdir(exist_ok=True)
    failed = 0
    for case in given.cases or [name for name in CASES if name != "live"]:
        words = ["jaxest", "bench", case, "--json", *(["--devices", str(given.devices)] if given.devices else [])]
        print(" ".join(words), file=sys.stderr, flush=True)
        done = subprocess.run([sys.executable, "-m", "jaxest.cli", *words[1:]], stdout=subprocess.PIPE, check=False)
        if done.returncode:
            failed += 1
            continue
        report = json.loads(done.stdout)
        (RESULTS / f"{case}.json").write_text(json.dumps(report, indent=1) + "\n")
        (RESULTS / f"{case}.md").write_text(table(case, " ".join(words), report))
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
