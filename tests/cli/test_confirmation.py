"""What takes over an hour says its cost and is confirmed first; what is done does not count."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tma_ray.campaign import Campaign, cells_of
from tma_ray.campaign.costs import confirmation, estimation
from tma_ray.campaign.costs.confirmation import confirm, long_cost
from tma_ray.campaign.costs.known import KNOWN, shipped_speed
from tma_ray.campaign.costs.speed import Throughput
from tma_ray.campaign.plan import Plan
from tma_ray.campaign.settings import Settings
from tma_ray.cli import main
from tma_ray.results import Committer, RunWriter
from tma_ray.runs import Schedule

MEASURED = Throughput("measured", 1_000, 50_000, 100)


@pytest.fixture(autouse=True)
def measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Stands for a measurement of seconds; nothing has been measured here before."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(estimation, "measured_speeds", lambda kinds, *_: dict.fromkeys(kinds, MEASURED))
    monkeypatch.setattr(confirmation, "terminal_question", lambda: None)


def plan_of(student: str, steps: int, seeds: int = 2) -> Plan:
    schedule = Schedule(steps=steps)
    return Campaign("planned", cells_of(("random",), (student,)), tuple(range(seeds)), schedule).plan()


def test_a_campaign_without_a_budget_is_refused_with_its_cost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    assert main(["campaign", "--teachers", "random,alp_gmm", "--results", str(root)]) == 2
    refusal = capsys.readouterr().err
    assert "core-hours" in refusal
    assert "pass --yes" in refusal
    assert main(["run", "--results", str(root)]) == 2
    assert "pass --yes" in capsys.readouterr().err
    assert main(["campaign", "--dry-run", "--results", str(root)]) == 0
    assert "cost: " in capsys.readouterr().out
    assert not root.exists()


def test_only_what_takes_over_an_hour_has_to_be_confirmed(tmp_path: Path) -> None:
    assert long_cost(plan_of("ppo", 1_000_000), str(tmp_path), Settings()) is None
    assert long_cost(plan_of("sac", 100_000), str(tmp_path), Settings()) is None
    cost = long_cost(plan_of("sac", 20_000_000), str(tmp_path), Settings())
    assert cost is not None
    per_run = 20_000_000 / next(iter(cost.throughputs.values())).training / 3600
    assert cost.hours == pytest.approx(2 * per_run, rel=0.05)


def test_runs_that_are_done_do_not_count(tmp_path: Path) -> None:
    plan = plan_of("sac", 20_000_000)
    whole = long_cost(plan, str(tmp_path), Settings())
    assert whole is not None
    committer = Committer.open(tmp_path)
    for done, left in enumerate((whole.hours / 2, 0.0), start=1):
        record = plan.runs[done - 1].record()
        attempt = committer.start(record)
        committer.finish(record, attempt, RunWriter(committer.store, record.run_id, attempt).finish())
        cost = long_cost(plan, str(tmp_path), Settings())
        assert (cost.hours if cost else 0.0) == pytest.approx(left)


def test_the_answer_decides() -> None:
    cost = long_cost(plan_of("sac", 20_000_000), "nowhere", Settings())
    assert cost is not None
    asked: list[str] = []

    def answer(text: str) -> object:
        def ask(question: str) -> str:
            asked.append(question)
            return text

        return ask

    confirm("campaign 'x'", cost, yes=True)
    confirm("campaign 'x'", cost, yes=False, ask=answer("y"))  # type: ignore[arg-type]
    assert "core-hours" in asked[0]
    for text in ("", "n", "what?"):
        with pytest.raises(ValueError, match="not started"):
            confirm("campaign 'x'", cost, yes=False, ask=answer(text))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="pass --yes"):
        confirm("campaign 'x'", cost, yes=False)


def test_known_speeds_hold_for_the_versions_that_they_were_measured_at() -> None:
    (spec,) = plan_of("ppo", 1_000, seeds=1).runs
    known = KNOWN["ppo"]
    spec = replace(
        spec, algorithm_versions={"student": known.algorithm_version}, physics_version=known.physics_version
    )
    assert (found := shipped_speed(spec, Settings())) is not None
    assert found.training == known.training
    assert shipped_speed(replace(spec, physics_version=0), Settings()) is None
    assert shipped_speed(replace(spec, algorithm_versions={"student": 0}), Settings()) is None
    (other,) = plan_of("ppo:epochs=50", 1_000, seeds=1).runs
    assert shipped_speed(other, Settings()) is None
