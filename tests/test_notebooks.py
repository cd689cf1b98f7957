"""The notebooks run from top to bottom on a release and the dataset beside them; none has outputs."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from jupyter_client.kernelspec import KernelSpec
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

from analysis.baselines import verify

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"

PICTURES = {"results": 6, "curricula": 11, "policies": 7}
"""Figures and animations that each promises."""


class ThisPython(AsyncKernelManager):
    """Kernels of the interpreter that runs the tests, whatever is installed for the user."""

    @property
    def kernel_spec(self) -> KernelSpec:
        return KernelSpec(argv=[sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"])


def read(name: str) -> Any:
    return nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)


def outputs(notebook: Any) -> list[Any]:
    return [output for cell in notebook.cells for output in cell.get("outputs", [])]


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.slow
def test_the_notebook_runs_and_draws(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TMA_RESULTS", raising=False)
    copy = shutil.copytree(NOTEBOOKS, tmp_path / "notebooks")
    before = {path for path in copy.rglob("*") if path.is_file()}
    notebook = read(name)
    place = {"metadata": {"path": str(copy)}}
    client = NotebookClient(notebook, timeout=300, kernel_manager_class=ThisPython, resources=place)
    client.execute()  # raises what a cell raises
    data = [output["data"] for output in outputs(notebook) if "data" in output]
    assert sum("image/png" in each or "image/gif" in each for each in data) == PICTURES[name]
    text = "".join(output["text"] for output in outputs(notebook) if output.get("name") == "stderr")
    assert "Warning" not in text
    assert {path for path in copy.rglob("*") if path.is_file()} == before


def test_a_root_of_ones_own_is_read_from_the_environment(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setenv("TMA_RESULTS", str(tmp_path / "mine"))
    for name in PICTURES:
        first = next(cell for cell in read(name).cells if cell.cell_type == "code").source
        names: dict[str, Any] = {}
        exec("\n".join(line for line in first.splitlines() if not line.startswith("%")), names)
        assert names["ROOT"] == str(tmp_path / "mine")


@pytest.mark.parametrize("name", PICTURES)
def test_the_notebook_is_committed_without_outputs(name: str) -> None:
    notebook = read(name)
    nbformat.validate(notebook)
    assert outputs(notebook) == []
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert {cell.execution_count for cell in code} == {None}
    assert notebook.cells[0].cell_type == "markdown"
    assert all(len(json.dumps(cell.get("metadata"))) == 2 for cell in notebook.cells)


def test_every_notebook_is_tested_and_its_data_are_whole_and_small() -> None:
    assert {path.stem for path in NOTEBOOKS.glob("*.ipynb")} == set(PICTURES)
    data = NOTEBOOKS / "data" / "ppo-lite"
    assert verify(data).whole
    assert sum(path.stat().st_size for path in data.rglob("*") if path.is_file()) < 2_000_000
