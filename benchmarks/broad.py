"""Mean errors over the trials of BROAD (Laidig et al. 2021), filter by filter and group by group, beside VQF.

    python benchmarks/broad.py FOLDER [--command]

FOLDER holds the trials as NPZ, one a file, under the authors' names (`24_disturbed_tapping_A.npz`), by whose words they
are grouped. The authors publish them as HDF5 and MAT (repository dlaidig/broad, CC BY 4.0); to be saved of each are
`gyr` (T, 3) rad/s, `acc` (T, 3) m/s2, `mag` (T, 3) uT, `quat` (T, 4) wxyz, the truth, NaN where it is unknown,
`movement` (T,), which samples count, and `fs` () Hz. A log of ours does as well, with streams gyroscope, accelerometer,
magnetometer, orientation and movement.

Printed is, with 6 and 9 axes, the mean over trials of the root mean square errors over
the samples that move and whose truth is known, in degrees; one setting for all trials, the complementary filter's gains
being 0.74 and 0.0012. With --command only the latter are measured, trial by trial, the way `jaxest estimate --method
orientation` gives them with `filter = "complementary"` in its config.
"""

import statistics
import sys
from pathlib import Path

from jaxest.bench import broad
from jaxest.cli import methods
from jaxest.io import read
from jaxest.types import InputError

SENSORS = {6: ("gyroscope", "accelerometer"), 9: ("gyroscope", "accelerometer", "magnetometer")}


def main(folder: Path) -> None:
    """Measure all filters."""
    measured = list(broad.rows(folder, progress=lambda message: print(message, file=sys.stderr, flush=True)))
    print(broad.table(measured))


def command(folder: Path) -> None:
    """Run the command's complementary filter on all trials and print a line a trial, then the means."""
    means: dict[str, list[float]] = {}
    for trial in broad.files(folder):
        log = read(trial)
        line = []
        for axes, sensors in SENSORS.items():
            request = methods.Request({"filter": "complementary"}, sensors)
            for row in methods.estimate("orientation", log, request).rows:
                if row.unit == "deg" and row.value is not None:
                    means.setdefault(f"{axes} axes, {row.metric}", []).append(row.value)
                    line.append(f"{axes}: {row.metric.split()[0]} {row.value:6.2f}")
        print(f"{trial.stem:48s} {'  '.join(line)}", flush=True)
    for name, values in means.items():
        print(f"{name}: {statistics.mean(values):.3f} deg, mean of {len(values)} trials")


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--command"]
    if len(words) != 1:
        sys.exit(__doc__)
    try:
        (command if "--command" in sys.argv else main)(Path(words[0]))
    except InputError as error:
        sys.exit(f"error: {error}")
