import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from corridor import Corridor
from small_runs import small_spec

from tma_ray.benchmark import challenges_of
from tma_ray.results.layout import LONGEST_ID
from tma_ray.runs import Cell, Plugin, RunSpec, Schedule, effective_spec
from tma_ray.support.decoding import DamagedFileError
from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS


def spec_of(**changes: object) -> RunSpec:
    return effective_spec(Cell(**changes), 0, Schedule(steps=1000))  # type: ignore[arg-type]


def test_a_spec_survives_json_with_its_identity(tmp_path: Path) -> None:
    spec = small_spec(tmp_path, "sac", "alp_gmm")
    again = RunSpec.from_dict(json.loads(json.dumps(spec.to_dict())))
    assert again.run_id == spec.run_id
    assert again.entropy == spec.entropy
    assert again.test_set.digest == spec.test_set.digest
    assert again.task_space == spec.task_space
    assert json.loads(spec.record().spec) == spec.to_dict()


def test_whatever_changes_the_result_changes_the_id(tmp_path: Path) -> None:
    spec = small_spec(tmp_path)
    others = [
        replace(spec, seed=1),
        replace(spec, teacher_hyperparameters={"explore": 0.5}),
        replace(spec, student_hyperparameters={**spec.student_hyperparameters, "gamma": 0.9}),
        replace(spec, schedule=Schedule(steps=5)),
        replace(spec, task_space=spec.task_space.with_bounds("distance", 0, 9)),
        replace(spec, physics_version=spec.physics_version + 1),
        replace(spec, plugins={"teacher": Plugin("mine", "abc")}),
        replace(spec, repeat="low"),
    ]
    assert len({spec.run_id, *(other.run_id for other in others)}) == 1 + len(others)
    assert replace(spec, seed=0).run_id == spec.run_id


@pytest.mark.parametrize("text", ["", "[]", "{}", "{", '{"seed": "0"}', '{"schedule": {"steps": -1}}'])
def test_what_is_no_spec_is_refused_by_the_name_of_its_file(text: str) -> None:
    with pytest.raises(DamagedFileError, match=r"policies/a/spec\.json"):
        RunSpec.from_json(text, "policies/a/spec.json")


def test_infinite_numbers_have_no_identity(tmp_path: Path) -> None:
    spec = small_spec(tmp_path)
    with pytest.raises(ValueError, match="must be finite"):
        _ = replace(spec, student_hyperparameters={"clip": math.inf}).run_id


def test_what_a_challenge_does_to_a_run_is_part_of_its_spec() -> None:
    forgetting, rugged = spec_of(challenge="forgetting_student"), spec_of(challenge="rugged_difficulty")
    assert (forgetting.resets, forgetting.cuts) == ((350, 700), 0)
    assert (rugged.resets, rugged.cuts) == ((), 4)
    forgetting = effective_spec(Cell(challenge="forgetting_student"), 0, Schedule())
    assert forgetting.resets == (7_000_000, 14_000_000)
    for spec in (forgetting, rugged):
        again = RunSpec.from_dict(json.loads(json.dumps(spec.to_dict())))
        assert (again.run_id, again.resets, again.cuts) == (spec.run_id, spec.resets, spec.cuts)
        assert replace(spec, resets=(), cuts=0).run_id != spec.run_id
    assert not {"resets", "cuts"} & set(spec_of().to_dict())


def test_levels_that_make_no_difference_share_runs() -> None:
    random = {spec_of(teacher="random", expert_knowledge=level).run_id for level in KnowledgeLevel}
    alp_gmm = [spec_of(teacher="alp_gmm", expert_knowledge=level).run_id for level in KnowledgeLevel]
    assert len(random) == 1
    assert alp_gmm[0] == alp_gmm[1] != alp_gmm[2]
    apart = {
        effective_spec(Cell(expert_knowledge=level), 0, Schedule(), independent_levels=True).entropy
        for level in KnowledgeLevel
    }
    assert len(apart) == 3


def test_the_defaults_are_the_papers() -> None:
    spec = effective_spec(Cell(), 0, Schedule())
    assert spec.schedule == Schedule(20_000_000, 500_000, 250_000, 100, 500_000)
    assert (spec.student, spec.embodiment, len(spec.test_set)) == ("sac", "classic_bipedal", 100)
    np.testing.assert_array_equal(spec.task_space.high, [3, 6])
    assert spec.student_hyperparameters["batch_size"] == 1000


@pytest.mark.parametrize("challenge", challenges_of("stump_tracks"))
def test_every_teacher_runs_on_every_challenge_or_is_refused_for_its_knowledge(challenge: str) -> None:
    refused = set()
    for teacher, level in itertools.product(TEACHERS.names(), KnowledgeLevel):
        try:
            spec = spec_of(challenge=challenge, teacher=teacher, expert_knowledge=level)
        except ValueError as error:
            assert "cannot run with expert knowledge" in str(error)  # noqa: PT017 - which are, is told below
            refused.add((teacher, level.value))
        else:
            assert (spec.challenge, spec.teacher) == (challenge, teacher)
    in_need = ("adr", "currot", "doraemon", "goal_gan", "ramp", "setter_solver", "sfl")
    assert refused == {(teacher, "none") for teacher in in_need} | {("ramp", "low")}


def test_a_teacher_without_its_knowledge_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="'odd_teachers:NeedsLow' cannot run with expert knowledge 'none'"):
        spec_of(teacher="odd_teachers:NeedsLow")
    high = spec_of(teacher="odd_teachers:NeedsLow", expert_knowledge=KnowledgeLevel.HIGH)
    assert high.expert_knowledge == "low"
    plugins = spec_of(teacher="odd_teachers:NeedsLow", expert_knowledge=KnowledgeLevel.LOW).plugins
    assert {part: plugin.module for part, plugin in plugins.items()} == {"teacher": "odd_teachers"}


@pytest.mark.parametrize(
    ("embodiment", "locomotion"),
    [
        ("classic_bipedal", "walking"),
        ("amphibious_bipedal", "walking"),
        ("fish", "swimming"),
        ("climbing_chimpanzee", "climbing"),
    ],
)
def test_parkour_tests_bodies_where_they_live(embodiment: str, locomotion: str) -> None:
    spec = spec_of(environment="parkour", embodiment=embodiment)
    assert spec.test_set.name == f"parkour_{locomotion}"
    assert len(spec.test_set) == 100


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"environment": "swing_up:SwingUp"},
            "'swing_up:SwingUp' has no bodies, and cannot be given 'spider'",
        ),
        (
            {"teacher": "sobol", "space": {"stump_height": (1, 1), "obstacle_spacing": (4, 4)}},
            "teacher 'sobol': Sobol does not teach in a space of a single task",
        ),
    ],
)
def test_what_would_fail_later_is_refused_when_planned(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        effective_spec(Cell(**{"student": "ppo", "embodiment": "spider", **changes}), 0, Schedule())


def test_names_too_long_for_file_names_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    import odd_teachers

    for length, fits in ((LONGEST_ID - 40, True), (LONGEST_ID + 16, False)):
        name = "A" * length
        monkeypatch.setattr(odd_teachers, name, odd_teachers.Inquisitive, raising=False)
        cell = Cell(student="ppo", teacher=f"odd_teachers:{name}")
        if fits:
            assert effective_spec(cell, 0, Schedule()).run_id.startswith("ppo_odd_teachers_AAA")
        else:
            with pytest.raises(ValueError, match=r"characters, which are part of file names: .*shorten"):
                _ = effective_spec(cell, 0, Schedule()).run_id


def test_a_test_set_outside_the_valid_domain_is_refused(tmp_path: Path) -> None:
    (tmp_path / "wild.csv").write_text("stump_height,obstacle_spacing\n0,6\n0,60\n")
    with pytest.raises(ValueError, match="task 1"):
        spec_of(test_set=str(tmp_path / "wild.csv"))


class OfItsOwn(gymnasium.Wrapper):
    """Any environment may say what counts as mastered, through wrappers as well."""

    mastery_return: object = -12.5

    def __init__(self) -> None:
        super().__init__(Corridor())


def test_an_environment_declares_when_a_task_is_mastered(monkeypatch: pytest.MonkeyPatch) -> None:
    own = f"{__name__}:OfItsOwn"
    assert spec_of(environment="corridor:Corridor", embodiment="").mastery_threshold == 230
    spec = spec_of(environment=own, embodiment="")
    assert spec.mastery_threshold == -12.5
    assert RunSpec.from_dict(spec.to_dict()).mastery_threshold == -12.5
    for wrong in ("230", np.inf, None):
        monkeypatch.setattr(OfItsOwn, "mastery_return", wrong)
        with pytest.raises(ValueError, match="mastery_return"):
            spec_of(environment=own, embodiment="")
