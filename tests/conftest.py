"""Strict settings for every test: rank promotion raises, warnings are errors, both precisions are at hand."""

import gc
import os
from ctypes.util import find_library
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
# One thread for the kernels of each process. Two workers fill two cores, and batched LAPACK calls that run at once wait
# for ever on a pool of two: each holds a thread until the other's work is done (jaxlib 0.10.2).
os.environ.setdefault("NPROC", "1")
if "DISPLAY" not in os.environ and find_library("EGL"):  # before anything imports mujoco, which looks only once
    os.environ.setdefault("MUJOCO_GL", "egl")
# Most of the suite's time is the compiler's, so programs are compiled quickly, here and in what a test starts. The live
# steps of the contract are compiled as users have them (`quick_compile.FULL`); all tests are with `XLA_FLAGS= pytest`.
if os.environ["JAX_PLATFORMS"] == "cpu" and version("jaxlib").startswith("0.10."):  # 0.11 does not know the first flag
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # the compilation cache logs every machine feature otherwise

import jax
import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared" / "data"

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)  # two workers share them
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

gc.set_threshold(200_000, 20, 50)  # a fifth of the time of tracing goes into looking for garbage otherwise

MOST = 20_000
"""Mappings of memory with which a worker goes on as it is; Linux allows 65530, a compiled program takes some."""


@pytest.fixture(autouse=True, scope="module")
def compiled_programs_are_let_go():
    """Forget compiled programs after a module where they are many: with all of the suite's the compiler crashes."""
    yield
    maps = Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > MOST:
        jax.clear_caches()
        gc.collect()


def pytest_collection_modifyitems(items):
    """Keep the tests of one row of a contract together: a worker then compiles the row's programs once for all."""
    places = [place for place, item in enumerate(items) if row_of(item)]
    order = {row: k for k, row in enumerate(dict.fromkeys(row_of(items[place]) for place in places))}
    together = sorted((items[place] for place in places), key=lambda item: order[row_of(item)])
    for place, item in zip(places, together, strict=True):
        items[place] = item


def row_of(item) -> str:
    """The contract's row that a test is about; empty for other tests."""
    row = item.callspec.params.get("row") if hasattr(item, "callspec") else None
    return f"{item.path}:{row.name}" if row else ""


@pytest.fixture(params=["float32", "float64"])
def dtype(request):
    """Run a test in float32 as users have it (x64 off) and in float64 (x64 on)."""
    with jax.enable_x64(request.param == "float64"):
        yield jax.numpy.dtype(request.param)


@pytest.fixture
def x64():
    """Run a test with 64-bit numbers allowed."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of recordings, robots and oracles beside the checkout."""
    if not SHARED.is_dir():
        pytest.skip("recorded: ../shared/data is absent")
    return SHARED
