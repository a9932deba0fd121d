"""Every attitude filter on the trials of BROAD, group by group, beside VQF where it is installed."""

from jaxest.bench import broad as benchmark
from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.viz import canvas


def broad(choice: Choice, say: Say) -> Section:
    """Measure all filters on the folder of `--broad`.

    Source: Laidig, Caruso, Cereatti, Seel 2021 (BROAD); Laidig, Seel 2023 (VQF).
    """
    assert choice.broad is not None  # `NEEDS` says so
    rows: list[Row] = list(benchmark.rows(choice.broad, progress=lambda message: say(message)))
    title = "BROAD: mean RMSE over the trials of each group"
    ours = tuple(f" axes, {name}" for name in (*benchmark.ONLINE, benchmark.SMOOTHER))
    whole = [row for row in rows if row.condition == "all" and row.metric.endswith(ours)]
    return Section("broad", title, rows, lambda path: canvas.bars(path, whole, "BROAD: mean RMSE over all trials"))


__all__ = ["broad"]
