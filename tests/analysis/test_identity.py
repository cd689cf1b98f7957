"""Runs that differ in anything that identifies them are never pooled, tested together or named alike."""

import copy
import itertools
import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from synthetic_results import SyntheticCampaign, mastering
from views import printed

from analysis.commands.rankings import show_ranking
from analysis.comparisons.sentences import ranking
from analysis.comparisons.sources import comparable_runs, named_jointly, reference_only, result_set
from analysis.data.columns import COMPARISON, NAMED
from analysis.data.loading import load
from analysis.data.naming import disambiguate_names
from analysis.data.specs import identity
from analysis.measures.evaluations import final_evaluations
from analysis.pages.report import write_report
from analysis.tables.paper_tables import table_results
from tma_ray.benchmark import MATRICES
from tma_ray.runs import Cell, Schedule, effective_spec
from tma_ray.tasks import KnowledgeLevel

SPEC: dict[str, Any] = {
    "environment": "stump_tracks",
    "environment_options": {"embodiment": "classic_bipedal"},
    "challenge": "original",
    "task_space": [{"name": "height", "low": 0, "high": 3, "unit": "m"}],
    "easy_task": [0.0],
    "test_set": {"name": "line", "dimensions": ["height"], "tasks": [[0.0], [1.0]]},
    "student": "ppo",
    "student_hyperparameters": {"learning_rate": 0.0003, "batch_size": 1000, "matmul_precision": "highest"},
    "teacher": "alp_gmm",
    "teacher_hyperparameters": {"explore": 0.2},
    "algorithm_versions": {"environment": 1, "student": 1, "teacher": 1},
    "plugins": {},
    "inputs": {},
    "schedule": {"steps": 1000},
    "mastery_threshold": 230,
}

SHA = "ab" * 32

OTHERS: dict[str, tuple[list[str], Any]] = {
    "learning rate": (["student_hyperparameters", "learning_rate"], 0.001),
    "batch size": (["student_hyperparameters", "batch_size"], 64),
    "precision": (["student_hyperparameters", "matmul_precision"], "medium"),
    "teacher setting": (["teacher_hyperparameters", "explore"], 0.5),
    "environment option": (["environment_options", "swinging_creepers"], True),
    "version of the teacher": (["algorithm_versions", "teacher"], 2),
    "version of the student": (["algorithm_versions", "student"], 2),
    "version of the environment": (["algorithm_versions", "environment"], 2),
    "before there were versions": (["algorithm_versions"], {}),
    "source of a plug-in": (["plugins", "teacher"], {"module": "mine", "digest": "cd" * 8}),
    "body in a file": (["inputs", "environment.embodiment"], {"name": "hopper.toml", "sha256": SHA}),
    "weights in a file": (["inputs", "environment.cppn_weights"], {"name": "w.npz", "sha256": SHA}),
    "task space": (["task_space", 0, "high"], 4),
    "test tasks": (["test_set", "tasks"], [[0.5], [1.0]]),
    "resets": (["resets"], [350]),
    "cuts": (["cuts"], 4),
}
"""What identifies a run: where it stands in the spec, and another value."""


def changed(path: list[Any], value: Any) -> dict[str, Any]:
    spec = copy.deepcopy(SPEC)
    place: Any = spec
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return spec


def write(root: Path, spec: dict[str, Any], masters: int, seeds: range, teacher: str = "alp_gmm") -> None:
    campaign = SyntheticCampaign(root, steps=1000, experiment="mine", prefix=f"{root.name}-")
    for seed in seeds:
        text = json.dumps({**spec, "teacher": teacher, "seed": seed}, sort_keys=True)
        returns = {1000: mastering(masters, 2)}
        campaign.plain_run(teacher, seed, returns, level="none", spec=text, student="ppo", test_set="line")


kinds = pytest.mark.parametrize(
    "kind", [pytest.param(each, marks=() if each == "learning rate" else pytest.mark.slow) for each in OTHERS]
)


@kinds
def test_other_runs_of_a_root_are_never_pooled(kind: str, tmp_path: Path) -> None:
    write(tmp_path, SPEC, 2, range(3))
    write(tmp_path, changed(*OTHERS[kind]), 0, range(3, 5))
    frames = load(tmp_path)
    table = ranking(frames)
    assert sorted(zip(table["mastered_area_mean"], table["n"], strict=True)) == [(0, 2), (100, 3)]
    mastered = final_evaluations(frames).groupby([*COMPARISON, "teacher"])["mastered_percent"]
    means = mastered.agg(["mean", "size"])
    assert sorted(means.itertuples(index=False, name=None)) == [(0, 2), (100, 3)]
    shown = [row for results in table_results(frames) for row in results.rows.itertuples()]
    assert {(row.mean, row.n) for row in shown} == {(0, 2), (100, 3)}
    assert any("2 runs of" in warning and "stand apart as" in warning for warning in frames.warnings)


@kinds
def test_other_runs_of_a_baseline_stand_beside_and_not_for_mine(kind: str, tmp_path: Path) -> None:
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    write(mine, SPEC, 2, range(3))
    write(theirs, changed(*OTHERS[kind]), 0, range(2))
    write(theirs, changed(*OTHERS[kind]), 1, range(2), "random")
    own, others, said = named_jointly(result_set(load(mine), "mine"), [result_set(load(theirs), "theirs")])
    runs = comparable_runs(own, others)
    pooled = runs.groupby(["environment", "challenge", "pool", "test_sets", "teacher"])["source"].nunique()
    assert set(pooled) == {1}
    assert any("stand apart as" in sentence for sentence in said)
    assert len(runs) + sum(map(len, (reference_only(own, side) for side in others))) > 3


def test_the_papers_matrices_keep_their_names() -> None:
    """All bodies, students and challenges of the benchmark in one root: nothing of it stands apart."""
    rows = []
    for matrix in MATRICES:
        for body, student in itertools.product(matrix.embodiments, matrix.students):
            for teacher, level in (("random", KnowledgeLevel.NONE), ("adr", KnowledgeLevel.LOW)):
                cell = Cell(matrix.environment, matrix.challenge, body, student, teacher, level)
                spec = effective_spec(cell, 0, Schedule())
                names = {name: getattr(spec, name) for name in NAMED if name != "test_set"}
                where = {"run_id": spec.run_id, "experiment": matrix.name, "test_set": spec.test_set.name}
                text = json.dumps(identity(spec.to_dict()), sort_keys=True)
                rows.append(names | where | {"engine": "Chipmunk", "physics_version": 1, "identity": text})
    cells = pd.DataFrame(rows)
    (named,), said = disambiguate_names([cells])
    assert said == ()
    assert named[NAMED].equals(cells[NAMED])


def test_a_challenge_of_another_environment_is_another_one(tmp_path: Path) -> None:
    write(tmp_path, SPEC, 2, range(3))
    campaign = SyntheticCampaign(tmp_path, steps=1000, experiment="parkour", environment="parkour")
    space = [{"name": "theta", "low": 0, "high": 1, "unit": ""}]
    text = json.dumps({**SPEC, "environment": "parkour", "task_space": space, "seed": 0}, sort_keys=True)
    names = {"student": "ppo", "test_set": "line", "run_id": "other"}
    campaign.plain_run("alp_gmm", 0, {1000: [300.0, 0.0]}, level="none", spec=text, **names)
    frames = load(tmp_path)
    assert frames.warnings == ()
    assert set(frames.cells["challenge"]) == {"original"}


def test_the_same_settings_are_pooled_across_roots(tmp_path: Path) -> None:
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    write(mine, SPEC, 2, range(3))
    write(theirs, SPEC, 1, range(3), "random")
    own, others, said = named_jointly(result_set(load(mine), "mine"), [result_set(load(theirs), "theirs")])
    assert said == ()
    assert set(comparable_runs(own, others)["source"]) == {"mine", "theirs"}


@pytest.mark.slow
def test_names_say_what_differs(tmp_path: Path) -> None:
    write(tmp_path, SPEC, 2, range(3))
    other = changed(*OTHERS["learning rate"])
    other["student_hyperparameters"]["batch_size"] = 64
    write(tmp_path, other, 0, range(3, 5))
    frames = load(tmp_path)
    name = "ppo:batch_size=64:learning_rate=0.001"
    assert set(frames.cells["student"]) == {"ppo", name}
    assert frames.warnings == (f"2 runs of student 'ppo' stand apart as '{name}'.",)
    text = printed(show_ranking, tmp_path)
    assert f"classic_bipedal/{name}" in text
    assert "2 runs of student 'ppo' stand apart" in text
    assert "stand apart as" in write_report(tmp_path, tmp_path / "page").read_text()


def test_runs_from_before_versions_say_so(tmp_path: Path) -> None:
    write(tmp_path, SPEC, 2, range(3))
    write(tmp_path, changed(*OTHERS["before there were versions"]), 0, range(3, 5))
    assert "alp_gmm:algorithm_version=before 1" in set(load(tmp_path).cells["teacher"])
