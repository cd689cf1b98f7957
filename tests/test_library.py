"""Runs and campaigns as functions of the package."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import analysis
import tma_ray
from tma_ray.campaign import CampaignSpec
from tma_ray.campaign.progress import Snapshot
from tma_ray.runs import Cell

SMALL = {"student": "ppo:hidden_units=16x16", "test_set": "stump_tracks:every=25"}


def test_a_run_is_one_call(tmp_path: Path) -> None:
    kept = tma_ray.train(Cell(**SMALL), teacher="random", schedule=300, results=tmp_path / "results")
    assert kept.curve["step"].tolist() == list(range(0, 301, 30))
    assert kept.mastered_area == pytest.approx(kept.curve["mastered_percent"].mean(), abs=10)
    assert kept.last_three == pytest.approx(kept.curve["mastered_percent"].tail(3).mean())
    assert analysis.load(tmp_path / "results").cells["teacher"].tolist() == ["random"]
    alone = tma_ray.train(**SMALL, teacher="random", schedule=300)  # leaves nothing
    assert alone.curve.equals(kept.curve)
    observation = np.linspace(-1, 1, 24, dtype=np.float32)
    assert alone.policy(observation).tolist() == kept.policy(observation).tolist()


def test_an_impossible_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="alp_gmm"):
        tma_ray.train(teacher="alp_gm", schedule=300, results=tmp_path / "results")
    with pytest.raises(TypeError, match="teachers"):
        tma_ray.train(teachers="alp_gmm", schedule=300)
    assert not list(tmp_path.iterdir())


if find_spec("optuna"):  # no requirement of the project, so that without it there is nothing to skip

    @pytest.mark.slow
    def test_optuna_tunes_a_teacher() -> None:
        text = (Path(__file__).parents[1] / "docs" / "optuna.md").read_text()
        block = text.partition("```python\n")[2].partition("```")[0]
        for usual, small in {"300_000": "300", "range(3)": "range(1)", "n_trials=50": "n_trials=2"}.items():
            assert usual in block
            block = block.replace(usual, small)
        seen: dict[str, object] = {}
        exec(compile(block, "optuna.md", "exec"), seen)
        assert len(seen["study"].trials) == 2


@pytest.mark.parametrize(
    ("done", "failed", "error", "message"),
    [
        (3, 0, None, ""),
        (2, 1, tma_ray.RunsFailedError, "1 of 3 runs failed: 'tma-ray status results'"),
        (1, 1, KeyboardInterrupt, "1 of 3 runs are done; the same call continues"),
    ],
)
def test_a_campaign_returns_its_outcome_or_raises(done, failed, error, message, monkeypatch):
    ended, asked = Snapshot(3, done, failed, 0, 0, 0, 0, []), []

    def execute_plan(plan, *arguments) -> Snapshot:
        asked.append(len(plan.runs))
        return ended

    monkeypatch.setattr("tma_ray.campaign.execution.execute_plan", execute_plan)
    campaign = CampaignSpec("three", (Cell(**SMALL),), (0, 1, 2))
    if error is None:
        assert tma_ray.run_campaign(campaign, local=True) is ended
    else:
        with pytest.raises(error, match=message):
            tma_ray.run_campaign(campaign, local=True)
    assert asked == [3]
