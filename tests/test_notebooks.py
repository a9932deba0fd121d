"""Every notebook runs from its first cell to its last, in its reduced form: three here, the others with `-m slow`."""

import os
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat")
nbclient = pytest.importorskip("nbclient")
pytest.importorskip("ipykernel")

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
FEW = ("01_bent_arm", "02_your_own_robot", "09_live")
LARGEST = 400_000  # bytes: results are kept small


def marked(path):
    return pytest.param(path, id=path.stem, marks=[] if path.stem in FEW else [pytest.mark.slow])


@pytest.mark.filterwarnings("default")  # of Jupyter's own
@pytest.mark.parametrize("path", [marked(path) for path in sorted(FOLDER.glob("*.ipynb"))])
def test_notebook_runs(path, tmp_path, monkeypatch):
    monkeypatch.setenv("JAXEST_SMALL", "1")
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(FOLDER.parent / ".cache" / "jax"))
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    book = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(
        book, timeout=300, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    )
    client.execute(env=dict(os.environ))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_kept_results_are_whole_and_small(path):
    book = nbformat.read(path, as_version=4)
    assert path.stat().st_size < LARGEST
    for cell in book.cells:
        if cell.cell_type == "code":
            assert cell.execution_count, f"a cell was not run: {cell.source[:60]}"
            assert not any(output.output_type == "error" for output in cell.outputs)
