"""An accelerator beside this machine's own processor: the same numbers, scaling curves, compile times.

    python benchmarks/accelerator.py FOLDER [--platform cuda] [--seconds 600] [--workers 16] [--last 2] [--small]
                                     [--curves robots links ...] [--cases guided ...]

First all programs are compiled, as many at a time as there are workers, and the two are compared (`agreement.py`);
then, alone, `jaxest bench scaling` runs on the accelerator and on the processor. Each row is written as it comes, so
that whatever ends the run leaves what was measured: `FOLDER/agreement.jsonl`, `compile.jsonl`, `PLATFORM.jsonl` and
`cpu.jsonl`, and at the end a table of all, `FOLDER/accelerator.md`. Parts that are not done in their share of the
seconds are ended. A program takes half a minute to compile, so that few minutes are enough for the largest sizes
(`--last`) or for some curves and cases, not for all.
"""

import argparse
import json
import os
import subprocess
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

COMPILE, MEASURE = 0.45, 0.75
"""Shares of the time after which compiling, and measuring on the accelerator, ends."""
CURVE_S = 20.0


def child(task: str, name: str, given: Any) -> None:
    """Do one task in this process, whose platform is chosen by its environment."""
    folder = given.folder
    if task == "agreement":
        import agreement

        keep(folder / "agreement.jsonl", (row._asdict() for row in agreement.rows(name)))
    elif task == "compile":
        keep(folder / "compile.jsonl", compiled(name, given))
    else:
        keep(folder / f"{task}.jsonl", measured(given))


def keep(path: Path, rows: Any) -> None:
    """Append rows to a file, each as soon as it is there."""
    for row in rows:
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")


def compiled(name: str, given: Any) -> Any:
    """Compile one curve's program of one size."""
    import jax

    from jaxest.bench import scaling_cases

    item, size = name.rsplit(":", 1)
    (curve,) = (one for one in scaling_cases.curves(given.small, False) if one.item == item)
    begun = time.perf_counter()
    program = curve.build(int(size))
    if hasattr(program.fn, "lower"):
        program.fn.lower(*program.args).compile()
    else:
        jax.block_until_ready(program.call())
    condition = f"{os.environ['JAX_PLATFORMS']}, {size}, with its data, beside other compilations"
    yield {"metric": item, "condition": condition, "value": time.perf_counter() - begun, "unit": "s"}


def measured(given: Any) -> Any:
    """Measure this platform's peak and its scaling curves; a curve that fails is told and left."""
    import jax

    from jaxest.bench import scaling, scaling_cases, work

    kind = jax.devices()[0].device_kind
    peak = work.peak(size=256, megabytes=1) if given.small else work.peak()
    yield {"metric": "peak, float32 matrix product", "condition": kind, "value": peak.operations, "unit": "1/s"}
    yield {"metric": "peak, copy read and written", "condition": kind, "value": peak.bandwidth, "unit": "B/s"}
    for curve in scaling_cases.curves(given.small, False):
        if given.curves and curve.item not in given.curves:
            continue
        chosen = {"small": given.small, "only": [curve.item], "last": given.last}
        try:
            for found in scaling.rows(peers=False, progress=say, seconds=CURVE_S, **chosen):
                yield found._asdict()
            program = curve.build(curve.sizes[-1])
            if curve.item in ("particles", "configurations"):
                floor = peak.floor(work.count(program.fn, *program.args))
                yield {"metric": "floor of " + curve.item, "condition": str(curve.sizes[-1]), "value": 1e6 * floor,
                       "unit": "us"}  # fmt: skip
        except Exception:
            traceback.print_exc()


def say(text: str) -> None:
    """Tell what is being done, and when."""
    print(f"{time.strftime('%H:%M:%S')} {text}", file=sys.stderr, flush=True)


def start(task: str, name: str, platforms: str, given: Any, until: float) -> None:
    """Run a task in a process of its own that is ended when its time is over."""
    if (left := until - time.monotonic()) < 5:
        return say(f"no time for {task} {name}")
    environment = os.environ | {
        "JAX_PLATFORMS": platforms,
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # several processes share the accelerator's memory
        "JAX_COMPILATION_CACHE_DIR": str(given.folder.resolve() / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "TF_CPP_MIN_LOG_LEVEL": "3",
    }
    words = [sys.executable, __file__, str(given.folder), "--task", task, "--name", name, "--last", str(given.last),
             *(["--small"] if given.small else []), *(["--curves", *given.curves] if given.curves else [])]  # fmt: skip
    say(f"{task} {name} on {platforms}")
    try:
        done = subprocess.run(words, env=environment, timeout=left, check=False).returncode
        say(f"{task} {name} on {platforms}: {'done' if done == 0 else f'failed with {done}'}")
    except subprocess.TimeoutExpired:
        say(f"{task} {name} on {platforms}: ended, its time is over")
    return None


def table(folder: Path, platform: str) -> str:
    """Return what was measured as Markdown."""

    def load(name: str) -> list[dict[str, Any]]:
        path = folder / f"{name}.jsonl"
        return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []

    ours, theirs = ({(r["metric"], r["condition"]): r for r in load(name)} for name in (platform, "cpu"))
    lines = [f"| metric | condition | {platform} | cpu | unit | times faster |", "|---|---|---|---|---|---|"]
    for metric, condition in dict.fromkeys([*ours, *theirs]):
        both = [one.get((metric, condition)) for one in (ours, theirs)]
        values = ["" if one is None else f"{one['value']:.4g}" for one in both]
        timed = all(both) and both[0]["unit"] in ("us", "s") and both[0]["value"]
        ratio = f"{both[1]['value'] / both[0]['value']:.3g}" if timed else ""
        unit = next(one["unit"] for one in both if one)
        lines.append(f"| {metric} | {condition} | {values[0]} | {values[1]} | {unit} | {ratio} |")
    for title in ("agreement", "compile"):
        lines += ["", f"| {title} | | |", "|---|---|---:|"]
        lines += [f"| {r['metric']} | {r['condition']} | {r['value']:.3g} |" for r in load(title)]
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Run everything, or one task of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--platform", default="cuda", help="as JAX_PLATFORMS names it")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--last", type=int, default=0, help="of each curve only so many sizes, the largest")
    parser.add_argument("--curves", nargs="*", default=[], help="what is counted; all by default")
    parser.add_argument("--cases", nargs="*", help="of agreement.py; all by default")
    parser.add_argument("--small", action="store_true", help="tiny sizes, to see that it runs")
    parser.add_argument("--task", help=argparse.SUPPRESS)
    parser.add_argument("--name", default="", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    given.folder.mkdir(parents=True, exist_ok=True)
    if given.task:
        child(given.task, given.name, given)
        return 0
    import agreement

    from jaxest.bench import scaling_cases

    begun, platform = time.monotonic(), given.platform
    until = begun + COMPILE * given.seconds
    studies = [
        curve for curve in scaling_cases.curves(given.small, False) if curve.item in given.curves or not given.curves
    ]
    programs = [f"{curve.item}:{size}" for curve in studies for size in curve.sizes[-given.last :]]
    cases = (list(agreement.CASES) if given.cases is None else given.cases)[: 2 if given.small else None]
    with ThreadPoolExecutor(given.workers) as pool:
        for case in cases:
            pool.submit(start, "agreement", case, f"{platform},cpu", given, until)
        for name in reversed(programs):  # what compiles longest first
            pool.submit(start, "compile", name, platform, given, until)
        for name in programs if platform != "cpu" else []:
            pool.submit(start, "compile", name, "cpu", given, until)
    start(platform, "", platform, given, begun + MEASURE * given.seconds)
    if platform != "cpu":
        start("cpu", "", "cpu", given, begun + given.seconds)
    text = table(given.folder, platform)
    (given.folder / "accelerator.md").write_text(text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
