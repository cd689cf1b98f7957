"""Campaigns that repeat a release: its cells, seeds and settings, with the teacher alone exchanged."""

from dataclasses import replace
from pathlib import Path

import pytest

from tma_ray.benchmark import find_experiment
from tma_ray.campaign import CampaignSpec, Plan, cells_of, costs, joined_plan, matrix_campaigns
from tma_ray.campaign.costs import Throughput
from tma_ray.campaign.repeating import like_plan
from tma_ray.cli import main
from tma_ray.results import Committer, Results, RunWriter, Table
from tma_ray.runs import RunSpec, Schedule
from tma_ray.tasks import KnowledgeLevel

SCHEDULE = Schedule(2_000, 1_000, 1_000, 10, 500)


def released(folder: Path, *plans: Plan) -> Results:
    """A root with an evaluation of each run."""
    committer = Committer.open(folder)
    for plan in plans:
        committer.write_cells(plan.name, plan.cell_rows)
        done = committer.done([spec.run_id for spec in plan.runs])
        for spec in (spec for spec in plan.runs if spec.run_id not in done):
            attempt = committer.start(spec.record())
            writer = RunWriter(committer.store, spec.run_id, attempt)
            row = {"step": 2_000, "test_set": spec.test_set.name, "task_index": 0, "task": [1.0, 1.0]}
            writer.add(Table.EVALUATIONS, [row | {"episodic_return": 1.0, "length": 10}])
            committer.finish(spec.record(), attempt, writer.finish())
    return Results.open(folder)


def core(
    teachers: tuple[str, ...] = ("random", "alp_gmm"), name: str = "core", seeds: tuple[int, ...] = (0, 1)
) -> Plan:
    matrices = find_experiment("lite_1").stage("core")
    small = [replace(matrix, seeds=seeds, steps=2_000) for matrix in matrices]
    return joined_plan(name, matrix_campaigns(small, teachers, SCHEDULE))


@pytest.fixture
def levels() -> Plan:
    cells = cells_of(("random",), ("ppo",), levels=(KnowledgeLevel.LOW,))
    return CampaignSpec("levels", cells, (0, 1, 2), SCHEDULE).plan()


def kinds(specs: tuple[RunSpec, ...]) -> set[tuple[object, ...]]:
    return {(s.challenge, s.embodiment, s.student, s.seed, s.schedule) for s in specs}


def test_cells_seeds_and_settings_are_those_of_the_release(tmp_path: Path, levels: Plan) -> None:
    source, more_seeds = core(), core(("random",), "seeds", (0, 1, 2))
    plan = like_plan("mine", released(tmp_path, source, levels, more_seeds), ["riac"], ["core"])
    assert kinds(plan.runs) == kinds(source.runs)
    assert len(plan.runs) == 7 * 2
    assert {spec.teacher for spec in plan.runs} == {"riac"}
    assert [spec.seed for spec in plan.runs] == [0] * 7 + [1] * 7
    columns = ("experiment", "challenge", "embodiment", "expert_knowledge", "seed")
    found, expected = ({tuple(row[name] for name in columns) for row in p.cell_rows} for p in (plan, source))
    assert found == expected


@pytest.mark.slow
def test_a_teacher_of_the_release_gives_the_runs_of_the_release(tmp_path: Path) -> None:
    source = core(("spdl:preset=release", "setter_solver"))
    plan = like_plan("mine", released(tmp_path, source), ["setter_solver", "spdl:preset=release"])
    assert {spec.run_id for spec in plan.runs} == {spec.run_id for spec in source.runs}


def test_challenges_and_seeds_narrow(tmp_path: Path, levels: Plan) -> None:
    results = released(tmp_path, core(), levels)
    plan = like_plan("mine", results, ["adr"], ["core"], ["diverse_students"], [1])
    assert {(s.challenge, s.seed) for s in plan.runs} == {("diverse_students", 1)}
    assert {s.embodiment for s in plan.runs} == {"short_bipedal", "spider"}
    with pytest.raises(ValueError, match=r"no challenge 'parkour'; it has .*original"):
        like_plan("mine", results, ["adr"], ["core"], ["parkour"])
    with pytest.raises(ValueError, match=r"no seed 9; it has 0, 1"):
        like_plan("mine", results, ["adr"], ["core"], [], [9])
    with pytest.raises(ValueError, match="no campaign 'kern'"):
        like_plan("mine", results, ["adr"], ["kern"])
    none = CampaignSpec("none", cells_of(("random",), ("ppo",)), (0,), SCHEDULE).plan()
    without = released(tmp_path / "none", none)
    with pytest.raises(ValueError, match=r"'adr' cannot run with expert knowledge 'none'"):
        like_plan("mine", without, ["adr"])


def test_a_release_of_other_physics_is_refused(tmp_path: Path) -> None:
    plan = core(("random",))
    older = tuple(replace(spec, physics_version=1) for spec in plan.runs)
    ids = {new.run_id: old.run_id for new, old in zip(plan.runs, older, strict=True)}
    rows = tuple(row | {"run_id": ids[row["run_id"]]} for row in plan.cell_rows)
    results = released(tmp_path, replace(plan, runs=older, cell_rows=rows))
    with pytest.raises(ValueError, match=r"cannot repeat.*physics_version: 1 there"):
        like_plan("mine", results, ["riac"])


def test_the_command_says_the_cost_and_refuses_what_the_release_decides(tmp_path, monkeypatch, capsys):
    measured = Throughput("measured", 1_000, 50_000, 100)  # stands for a measurement of seconds
    monkeypatch.setattr(costs, "known_speeds", lambda kinds, *_: dict.fromkeys(kinds, measured))
    monkeypatch.chdir(tmp_path)
    released(tmp_path / "theirs", core(("random",)))
    like = ["campaign", "--like", "theirs", "--results", "mine", "--dry-run"]
    assert main([*like, "--teachers", "riac", "--challenges", "original", "--seeds", "1"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("cost: ")
    assert "1 cell like those of" in said
    assert main([*like, "--teachers", "riac", "--students", "sac", "--steps", "1k"]) == 2
    assert "--students, --steps from the release" in capsys.readouterr().err
    assert main(like) == 2
    assert "--teachers mine:Teacher" in capsys.readouterr().err
    assert main([*like, "--teachers", "riac", "--name", "no name"]) == 2
    assert "id 'no name' is part of file names" in capsys.readouterr().err
