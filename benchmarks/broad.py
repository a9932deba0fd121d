"""Mean errors over the trials of BROAD (Laidig et al. 2021), as `jaxest estimate --method orientation` gives them.

    python benchmarks/broad.py FOLDER

FOLDER holds the trials as NPZ. Printed is, for 6 and 9 axes with the default gains, the mean over trials of the root
mean square errors over the samples that move and whose truth is known, in degrees.
"""

import statistics
import sys
from pathlib import Path

from jaxest.cli import methods
from jaxest.io import read

SENSORS = {6: ("gyroscope", "accelerometer"), 9: ("gyroscope", "accelerometer", "magnetometer")}


def main(folder: Path) -> None:
    """Run all trials of a folder and print a line a trial, then the means."""
    trials = sorted(folder.glob("*.npz"))
    if not trials:
        sys.exit(f"{folder}: no NPZ file")
    means: dict[str, list[float]] = {}
    for trial in trials:
        log = read(trial)
        line = []
        for axes, sensors in SENSORS.items():
            outcome = methods.estimate("orientation", log, methods.Request(sensors=sensors))
            for row in outcome.rows:
                if row.unit == "deg" and row.value is not None:
                    means.setdefault(f"{axes} axes, {row.metric}", []).append(row.value)
                    line.append(f"{axes}: {row.metric.split()[0]} {row.value:6.2f}")
        print(f"{trial.stem:48s} {'  '.join(line)}", flush=True)
    for name, values in means.items():
        print(f"{name}: {statistics.mean(values):.3f} deg, mean of {len(values)} trials")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
