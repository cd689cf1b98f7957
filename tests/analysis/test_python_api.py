"""What `analysis` offers from Python: the page that explains it works, and importing it stays cheap."""

import re
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import analysis
from analysis.baselines import BaselineError
from analysis.data.columns import COMPARED
from tma_ray.results import ResultsRootError

HERE = Path(__file__).parents[2]
PAGE = (HERE / "docs" / "analysis.md").read_text()
ROOT = HERE / "notebooks" / "data" / "ppo-lite"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """The folder in which all Python of the page has been run, and the names that it left."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(ROOT, folder / "results")
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL):
            exec(block, names)
    return folder, names


def test_the_page_works(page: tuple[Path, dict[str, Any]]) -> None:
    folder, names = page
    assert {"radar.pdf", "radar.png"} == {path.name for path in (folder / "figures").iterdir()}
    assert len(pd.read_csv(folder / "results.csv")) == len(names["results"]) == 8
    assert r"\toprule" in (folder / "challenges_none-ppo.tex").read_text()
    assert len(names["beside"]) == 8
    assert len(names["strip"].axes) == 6
    assert names["wide"].shape == (9, 16)
    assert names["intervals"]["reason"].eq("").all()


def test_the_page_names_every_column(page: tuple[Path, dict[str, Any]]) -> None:
    frames = page[1]["frames"]
    run_id = page[1]["run"]["run_id"]
    tables = [frames.cells, frames.evaluations, frames.training, frames.attempts, frames.test_tasks]
    tables += [frames.episodes(run_id), frames.curriculum(run_id), frames.teacher_log(run_id)]
    missing = {column for table in tables for column in table if f"`{column}`" not in PAGE}
    assert not missing


def test_every_name_that_it_offers_is_there() -> None:
    """Functions, not the modules of the same name, whatever was imported before."""
    import analysis.measures.run_measures

    for name in analysis.__all__:
        assert getattr(analysis, name) is not None
        assert name in dir(analysis)
    assert callable(analysis.pairwise)
    assert callable(analysis.task_axes)
    assert callable(analysis.run_measures)
    with pytest.raises(AttributeError, match="no attribute 'radars'"):
        analysis.radars  # noqa: B018


def test_result_runs_keep_every_step() -> None:
    frames = analysis.load(ROOT)
    steps = [500_000, 1_000_000]
    runs = analysis.result_runs(frames, analysis.evaluations_at(frames, steps))
    assert len(runs) == 32
    assert set(runs["step"]) == set(steps)
    tests = analysis.pairwise(runs, "mastered_percent", "random", [*COMPARED, "step"])
    assert len(tests) == 8


def test_a_release_is_read_by_its_name() -> None:
    frames = analysis.load("lite-1")
    assert set(frames.cells["student"]) == {"ppo"}
    with pytest.raises(BaselineError, match="no runs"):
        analysis.load("paper-2021")


def test_a_root_that_does_not_exist_is_refused_with_advice(tmp_path: Path) -> None:
    with pytest.raises(ResultsRootError, match=r"nowhere.*root\.json.*--results"):
        analysis.load(tmp_path / "nowhere")
