"""Every notebook runs from top to bottom, and carries no outputs."""

import os
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
# The last one compiles a simulator of its own: first, or one worker waits for it at the end.
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"), reverse=True)
INLINE = "module://matplotlib_inline.backend_inline"
TIMEOUT = 300  # s per cell, on a busy machine


def test_there_are_notebooks():
    numbers = [int(p.name[:2]) for p in NOTEBOOKS]
    assert len(set(numbers)) == len(numbers)
    assert len(NOTEBOOKS) >= 3


@pytest.mark.long
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda p: p.stem)
def test_runs(file, tmp_path):
    notebook = nbformat.read(file, as_version=4)
    client = NotebookClient(notebook, timeout=TIMEOUT, resources={"metadata": {"path": tmp_path}})
    client.execute(env={**os.environ, "MPLBACKEND": INLINE})
    figures = [
        out
        for cell in notebook.cells
        if cell.cell_type == "code"
        for out in cell.outputs
        if "image/png" in out.get("data", {})
    ]
    assert figures


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda p: p.stem)
def test_carries_text_but_no_outputs(file):
    cells = nbformat.read(file, as_version=4).cells
    code = [cell for cell in cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    assert sum("assert" in cell.source for cell in code) >= 5
    assert sum(cell.cell_type == "markdown" for cell in cells) >= 5
