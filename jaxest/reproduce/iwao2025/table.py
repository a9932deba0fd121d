"""Table II: errors by condition, over rooms."""

import multiprocessing
import os
import threading
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from jaxest.io.report import Row
from jaxest.reproduce import Choice, Say, Section
from jaxest.reproduce.iwao2025 import runs
from jaxest.reproduce.iwao2025.conditions import CHAIN, Condition, chosen, condition
from jaxest.viz import canvas

RUNS = 3
SECONDS = 60.0
SMALL = Condition("5 links", 5, 2, 4)

Results = dict[str, list[dict[str, Any]]]


def table2(choice: Choice, say: Say) -> Section:
    """Run each condition in `choice.runs` rooms, two or more at a time.

    Source: Iwao 2025, Table II.
    """
    names = chosen(tuple(choice.rows))
    count, seconds = (1, 1.0) if choice.small else (choice.runs or RUNS, SECONDS)
    if choice.small:
        names = names[:1]
    plans = [runs.Plan(100 * choice.seed + i, seconds) for i in range(count)]
    results = gathered(names, plans, choice.work, say, SMALL if choice.small else None)
    title = f"Table II: position error, {count} room{'s' * (count != 1)} of {seconds:g} s"
    rows = [row for name in names for row in _rows(name, results[name])]

    def paint(figure: Any) -> None:
        _bars(figure, names, results)

    return Section("table2", title, rows, lambda path: canvas.save(path, (9, 5), paint, title))


def gathered(
    names: Sequence[str], plans: Sequence[runs.Plan], work: Path | None, say: Say, small: Condition | None = None
) -> Results:
    """Run every condition on every plan; in processes of their own where there are several."""
    jobs = [(name, small or condition(name), plan, work) for name in names for plan in plans]
    found: dict[tuple[str, int], dict[str, Any]] = {}
    workers = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1, len(jobs))
    if workers < 2:
        for done, job in enumerate(jobs):
            say(f"table 2: {job[0]}, room {job[2].seed} ({done + 1} of {len(jobs)})")
            found[job[0], job[2].seed] = runs.result(*job)
    else:
        if work is None:
            runs.for_now(os.getpid())
        # XLA's threads do not survive a fork.
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(workers, mp_context=spawn, initializer=_as_worker) as pool:
            waiting = {pool.submit(runs.result, *job): job for job in jobs}
            for done, future in enumerate(as_completed(waiting)):
                name, _, plan, _ = waiting[future]
                found[name, plan.seed] = future.result()
                say(f"table 2: {name}, room {plan.seed}: {_said(found[name, plan.seed])} ({done + 1} of {len(jobs)})")
    return {name: [found[name, plan.seed] for plan in plans] for name in names}


def _as_worker() -> None:
    """Give a worker's kernels one thread, and end it with the process that started it.

    With a thread for each core, kernels of several workers wait for each other. A worker whose parent was killed would
    go on with its run, and then wait for the next one for ever.
    """
    os.environ.setdefault("NPROC", "1")
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _said(result: dict[str, Any]) -> str:
    link, error = max(result["mean"].items(), key=lambda item: int(item[0]))
    return f"{error:.1f} cm at link {link}"


def _rows(name: str, results: list[dict[str, Any]]) -> list[Row]:
    one, count = condition(name), len(results)
    rows = []
    for link in results[0]["mean"]:
        errors = [r["mean"][link] for r in results]
        paper = one.paper.get(int(link))
        reference = paper[0] if paper else None
        rows.append(Row("position error", f"{name}, link {link}", float(np.mean(errors)), "cm", float(np.std(errors)),
                        count, reference, "paper" if paper else None,
                        reference / float(np.mean(errors)) if reference else None))  # fmt: skip
    last = max(results[0]["mean"], key=int)
    blind = float(np.mean([r["blind"][last] for r in results]))
    kinematic = one.kinematics.get(int(last))
    rows.append(Row("kinematics alone", f"{name}, link {last}", blind, "cm", n=count, reference=kinematic,
                    reference_name="paper" if kinematic else None))  # fmt: skip
    rows.append(Row("worst room", f"{name}, link {last}", max(r["mean"][last] for r in results), "cm", n=count))
    rows.append(Row("largest error after a third", f"{name}, link {last}", max(r["settled"] for r in results), "cm",
                    n=count))  # fmt: skip
    right = 100 * float(np.mean([r["map"] for r in results]))
    rows.append(Row("map points within 5 cm of a surface", name, right, "%", n=count))
    for key, what in (("nees_bias", "bias"), ("nees_pose", "pose")):
        if key in results[0]:
            each = np.mean([r[key] for r in results], axis=0)
            mean, low, high = float(np.mean(each)), float(np.min(each)), float(np.max(each))
            rows.append(Row(f"NEES per degree of freedom, {what}", f"{name}, mean over links", mean, "1", n=count))
            rows.append(Row(f"NEES per degree of freedom, {what}", f"{name}, smallest link", low, "1", n=count))
            rows.append(Row(f"NEES per degree of freedom, {what}", f"{name}, largest link", high, "1", n=count))
    return rows


def _bars(figure: Any, names: Sequence[str], results: Results) -> None:
    axis = canvas.plain(figure.subplots(), xlabel="error of the last link's position [cm]")
    place = np.arange(len(names))[::-1]
    for at, name in zip(place, names, strict=True):
        last = max(results[name][0]["mean"], key=int)
        errors = [r["mean"][last] for r in results[name]]
        paper = condition(name).paper.get(int(last)) if name != CHAIN else None
        axis.barh(at + 0.18, np.mean(errors), 0.34, color=canvas.BLUE, label="jaxest" if at == place[0] else None)
        axis.plot(errors, np.full(len(errors), at + 0.18), "o", color="white", markeredgecolor=canvas.BLUE, ms=4)
        if paper:
            axis.barh(at - 0.18, paper[0], 0.34, xerr=paper[1], color=canvas.GREY, ecolor="0.15",
                      label="paper" if at == place[0] else None)  # fmt: skip
    axis.set_yticks(place, names)
    axis.legend(frameon=False, fontsize=9)


__all__ = ["gathered", "table2"]
