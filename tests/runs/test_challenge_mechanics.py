"""What challenges do to a run: students that forget, and teachers that work in a shuffled space."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_runs import data_files, new_run, rows, run, small_spec

from tma_ray.results import Table
from tma_ray.runs import Cell, InlineTeacher, Placement, RunSpec, Schedule, effective_spec
from tma_ray.runs.spec import placement_generator, task_space_shuffle
from tma_ray.tasks import KnowledgeLevel, ShuffledSpace


def landscape(spec: RunSpec) -> ShuffledSpace:
    return task_space_shuffle(spec, placement_generator(spec))  # type: ignore[return-value]


def told(root: Path, table: Table, until: int) -> list[dict[str, Any]]:
    """Rows of one run up to a step, without its id."""
    found = [row for row in rows(root, table) if row["step"] <= until]
    for row in found:
        del row["run_id"]
    return found


def test_a_student_forgets_at_its_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = replace(small_spec(tmp_path, steps=1_500), resets=(525, 526, 1_000))
    one, seen = new_run(spec, tmp_path / "root"), []
    reset = one.student.reset

    def forget() -> None:
        seen.append((one.progress.step, one.progress.evaluations))
        reset()

    monkeypatch.setattr(one.student, "reset", forget)
    ends = set()
    while not one.finished:
        ends |= {episode.step for episode in [one.advance()] if episode}
    assert seen == [(525, 1), (526, 1), (1_000, 2)]
    assert not ends >= {525, 526}, "at least one is within an episode"


@pytest.mark.parametrize("student", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
def test_up_to_its_first_reset_a_run_is_one_without(tmp_path: Path, student: str) -> None:
    often = {"evaluation_interval": 500, "training_window": 500}
    plain = small_spec(tmp_path, student, "alp_gmm", steps=1_500, **often)
    run(plain, tmp_path / "plain")
    run(replace(plain, resets=(1_000,)), tmp_path / "forgetting")
    for table in (Table.EPISODES, Table.EVALUATIONS, Table.CURRICULUM, Table.TRAINING):
        first, second = (told(tmp_path / name, table, 1_000) for name in ("plain", "forgetting"))
        assert first == second
        assert first
    last = [told(tmp_path / name, Table.EVALUATIONS, 1_500)[-3:] for name in ("plain", "forgetting")]
    assert last[0] != last[1]


@pytest.mark.slow
@pytest.mark.parametrize(("student", "cuts"), [("ppo", 4), ("sac", 0)])
def test_stopped_around_a_reset_and_resumed(tmp_path, monkeypatch, student, cuts):
    """Checkpoints after every episode, with several files of a replay buffer that a reset empties."""
    monkeypatch.setattr("tma_ray.students.replay.SEGMENT_ROWS", 100)
    spec = replace(small_spec(tmp_path, student, "alp_gmm", steps=2_000), resets=(1_050, 1_600), cuts=cuts)
    run(spec, tmp_path / "undisturbed")
    ends = [row["step"] for row in rows(tmp_path / "undisturbed", Table.EPISODES)]
    before = sum(step < 1_050 for step in ends)
    for episodes in (before, 1, 1):
        stopped = run(spec, tmp_path / "resumed", episodes, Placement(checkpoint_seconds=0.0))
        assert stopped == "stopped"
    assert run(spec, tmp_path / "resumed") == "done"
    assert data_files(tmp_path / "resumed") == data_files(tmp_path / "undisturbed")


def test_resets_must_lie_within_the_budget(tmp_path: Path) -> None:
    spec = small_spec(tmp_path)
    for resets in ((0,), (5, 5), (7, 5), (3_000,)):
        with pytest.raises(ValueError, match="raise the budget"):
            replace(spec, resets=resets)
    with pytest.raises(ValueError, match="resets after 0, 1 of 1 steps"):
        effective_spec(Cell(challenge="forgetting_student"), 0, Schedule(steps=1))


def test_the_world_is_built_where_a_shuffled_task_lies(tmp_path: Path) -> None:
    spec = replace(small_spec(tmp_path), cuts=4)
    one, moved = new_run(spec, tmp_path / "root"), 0
    for _ in range(20):
        episode = one.advance()
        world_task = landscape(spec).to_world(episode.task)
        np.testing.assert_array_equal(episode.initial_observation[:2], world_task)
        moved += not np.array_equal(world_task, episode.task)
    assert moved > 5


def test_episodes_tell_both_tasks_and_test_tasks_are_not_shuffled(tmp_path: Path) -> None:
    plain = small_spec(tmp_path, steps=1_000)
    shuffled = replace(plain, cuts=4)
    vars(plain)["entropy"] = vars(shuffled)["entropy"] = 1  # the same student
    for name, spec in (("plain", plain), ("shuffled", shuffled)):
        run(spec, tmp_path / name)
    assert told(tmp_path / "plain", Table.EVALUATIONS, 0) == told(tmp_path / "shuffled", Table.EVALUATIONS, 0)
    episodes = rows(tmp_path / "shuffled", Table.EPISODES)
    tasks, world_tasks = (np.array([row[key] for row in episodes], "f4") for key in ("task", "world_task"))
    np.testing.assert_array_equal(landscape(shuffled).to_world(tasks), world_tasks)
    assert all(row["world_task"] is None for row in rows(tmp_path / "plain", Table.EPISODES))


def test_all_teachers_of_a_seed_meet_the_same_landscape(tmp_path: Path) -> None:
    specs = [replace(small_spec(tmp_path, teacher=name), cuts=4) for name in ("random", "alp_gmm")]
    first, second = (landscape(spec).order for spec in specs)
    np.testing.assert_array_equal(first, second)
    orders = {str(landscape(replace(specs[0], seed=seed)).order) for seed in range(8)}
    assert len(orders) > 4


def test_the_expert_of_a_rugged_landscape_points_at_the_easy_task() -> None:
    """ADR begins with the initial mean as its only task."""
    cell = Cell(challenge="rugged_difficulty", teacher="adr", expert_knowledge=KnowledgeLevel.HIGH)
    first = effective_spec(cell, 0, Schedule())
    tasks = []
    for seed in range(6):
        spec = replace(first, seed=seed)
        task = InlineTeacher(spec).exchange(None).task
        np.testing.assert_allclose(landscape(spec).to_world(task), [0, 6], atol=1e-5)
        tasks.append(task)
    assert not np.allclose(tasks, [0, 6])
