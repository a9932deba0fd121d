"""Ten minutes of live use at 1 kHz: what each step took, and whether memory grew.

    python benchmarks/live.py [MINUTES]

The packaged arm's filter is fed by another process through a UDP port, as `jaxest bench live` does for 20 s.
"""

import sys

from jaxest.bench import live


def main(minutes: float) -> None:
    """Run and print."""
    for row in live.rows(peers=False, progress=lambda message: print(message, file=sys.stderr), seconds=60 * minutes):
        beside = "" if row.reference is None else f", {row.reference:.6g} {row.unit} by {row.reference_name}"
        print(f"{row.metric}: {row.value:.6g} {row.unit} (n = {row.n}){beside}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
