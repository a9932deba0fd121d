"""The command line: `jaxest demo | inspect | estimate | show | compare | tune | reproduce | bench | doctor`.

One file a command; each loads what it needs when it runs, so that `jaxest --help` is quick. `main` is the entry point.
Commands only read arguments, call the library and print: whatever they compute can be computed from Python as well.

Compiled programs are kept between runs in the user's cache folder, unless `JAX_COMPILATION_CACHE_DIR` names another
one, or is empty to keep none; `jaxest doctor` tells where.
"""

import os

CACHE = "JAX_COMPILATION_CACHE_DIR"
SHORTEST = "0.2"  # s, a program that compiles faster is not worth a file


def main() -> None:
    """Run the command that the process was started with."""
    keep_programs()
    from jaxest.cli.app import app

    app()


def keep_programs() -> None:
    """Name the folder of compiled programs to JAX, which reads its settings from the environment on import."""
    if CACHE in os.environ:
        return
    from platformdirs import user_cache_path

    os.environ[CACHE] = str(user_cache_path("jaxest", appauthor=False) / "programs")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", SHORTEST)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA lists every feature of the processor otherwise


__all__ = ["CACHE", "keep_programs", "main"]
