"""Every attitude filter on the trials of BROAD, group by group, beside VQF where it is installed."""

from jaxest.bench import broad as benchmark
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section


def broad(choice: Choice, say: Say) -> Section:
    """Measure all filters on the folder of `--broad`; without one there is nothing to measure.

    Source: Laidig, Caruso, Cereatti, Seel 2021 (BROAD); Laidig, Seel 2023 (VQF).
    """
    if choice.broad is None:
        say("broad: left out, name the trials' folder with --broad")
        return Section("broad", "BROAD: left out, name the trials' folder with --broad", [])
    rows: list[Row] = list(benchmark.rows(choice.broad, progress=lambda message: say(message)))
    return Section("broad", "BROAD: mean RMSE over the trials of each group", rows)


__all__ = ["broad"]
