"""Episodes from which the student does not learn, and evaluations that a teacher asks for."""

import pickle
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_runs import new_run, one_episode, rows, run, small_spec, stump_tracks_spec

from tma_ray.results import Table
from tma_ray.runs import Cell, InlineTeacher, Reply, Schedule, effective_spec, evaluation
from tma_ray.runs.evaluation import UntrainedEpisodes
from tma_ray.runs.run import Run
from tma_ray.students import STUDENTS, Student
from tma_ray.tasks import Answer, Episode


def student_files(run: Run, folder: Path) -> dict[str, bytes]:
    """Return all that a run saves of its student."""
    folder.mkdir()
    run.student.save(folder)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose teacher examines its student."""
    folder = tmp_path_factory.mktemp("examined")
    run(small_spec(folder, teacher="odd_teachers:Examining"), folder / "root")
    return folder / "root"


def test_all_steps_count_to_the_budget(finished: Path) -> None:
    episodes, asked = rows(finished, Table.EPISODES), rows(finished, Table.TEACHER_LOG)
    assert [row["trains"] for row in episodes] == [index % 2 == 0 for index in range(len(episodes))]
    assert len(asked) > 3
    for index, row in enumerate(episodes):
        played = sum(each["length"] for each in episodes[: index + 1])
        evaluated = sum(dict(a["scalars"])["steps"] for a in asked if a["episode"] < row["episode"] + 1)
        assert row["step"] == played + evaluated
    assert max(row["step"] for row in asked + episodes) <= 3_000


def test_the_schedule_is_kept_where_an_evaluation_passes_over_it(finished: Path) -> None:
    asked = [(row["step"], int(dict(row["scalars"])["steps"])) for row in rows(finished, Table.TEACHER_LOG)]
    assert any((step - steps) // 500 < step // 500 for step, steps in asked), "some pass over a probe"
    evaluations, curriculum = rows(finished, Table.EVALUATIONS), rows(finished, Table.CURRICULUM)
    assert [row["step"] for row in evaluations[::3]] == [0, 1_000, 2_000, 3_000]
    assert [row["step"] for row in curriculum[::10]] == list(range(0, 3_001, 500))
    training = rows(finished, Table.TRAINING)
    assert [row["step"] for row in training] == [1_000, 2_000, 3_000]
    learned = [row for row in rows(finished, Table.EPISODES) if row["trains"]]
    assert sum(row["episodes"] for row in training) == len(learned)


@pytest.mark.parametrize("student", ["ppo", "sac"])
def test_the_student_stays_as_it_was(tmp_path: Path, student: str) -> None:
    spec = small_spec(tmp_path, student, teacher="odd_teachers:Watching", steps=300)
    watched = new_run(spec, tmp_path / "root")
    before = student_files(watched, tmp_path / "before")
    returns = []
    while not watched.finished:
        episode = watched.advance()
        returns += [] if episode is None else [episode.episodic_return]
    assert len(set(returns)) == len(returns) > 5
    assert student_files(watched, tmp_path / "after") == before
    watched.close()


class DistantTeacher(InlineTeacher):
    """A teacher whose messages are pickled both ways, as those of an actor are."""

    def exchange(self, episode: Episode | None) -> Reply:
        return _sent(super().exchange(_sent(episode)))

    def answer(self, answer: Answer) -> Reply:
        return _sent(super().answer(_sent(answer)))


def _sent(message: Any) -> Any:
    return pickle.loads(pickle.dumps(message))


@pytest.mark.parametrize("teacher", ["odd_teachers:Examining", "sfl", "accel"])
def test_it_makes_no_difference_where_the_teacher_is(tmp_path: Path, teacher: str) -> None:
    spec, played = small_spec(tmp_path, teacher=teacher, steps=1_500), []
    for kind in (InlineTeacher, DistantTeacher):
        whole = new_run(spec, tmp_path / kind.__name__, teacher=kind)
        episodes = []
        while not whole.finished:
            episode = whole.advance()
            episodes.append(None if episode is None else (episode.episodic_return, *episode.task.tolist()))
        played.append(episodes)
        whole.close()
    assert played[0] == played[1]


@pytest.mark.parametrize(
    "make_spec", [small_spec, partial(stump_tracks_spec, student="ppo", teacher="random")]
)
def test_an_evaluation_is_one_episode_of_each_task(tmp_path, monkeypatch, make_spec):
    """Three at a time; more of them, then fewer."""
    monkeypatch.setattr(evaluation, "MAX_WORLDS", 3)
    spec = make_spec(tmp_path)
    whole = new_run(spec, tmp_path / "root")
    playing = UntrainedEpisodes(spec, np.random.SeedSequence(5))
    seeds = np.random.default_rng(np.random.SeedSequence(5))
    for count in (2, 7, 1):
        tasks, before = spec.task_space.sample(np.random.default_rng(count), count), playing.state
        outcomes = playing.evaluate(whole.student, tasks, greedy=True, budget=100_000)
        for index, seed in enumerate(seeds.integers(2**31, size=count)):
            played = one_episode(whole.environment, whole.student.act_greedily, tasks[index], int(seed))
            assert played == (outcomes.lengths[index], pytest.approx(outcomes.episodic_returns[index]))
    steps = int(outcomes.lengths.sum())
    for budget, ended in ((1, True), (steps, True), (steps + 1, False)):
        playing.state = before
        assert (playing.evaluate(whole.student, tasks, greedy=True, budget=budget) is None) == ended
    playing.close()
    whole.close()


def test_a_run_ends_where_an_evaluation_takes_what_is_left(tmp_path: Path) -> None:
    spec = small_spec(tmp_path, teacher="odd_teachers:Examining", steps=3_000)
    asked = new_run(spec, tmp_path / "root")
    while asked.progress.episodes < 5:
        asked.advance()
    asked.progress.step = 2_990  # the next evaluation takes more than ten steps
    asked._next_event = 3_000
    while not asked.finished:
        asked.advance()
    assert asked.progress.step == 3_000
    assert asked.progress.evaluations == 2
    asked.close()


@pytest.mark.parametrize(
    ("teacher", "said"),
    [
        ("Covert", "does not learn: declare wants_evaluations"),
        ("Prying", "for an evaluation: declare wants_evaluations"),
        ("Undeclared", "declare wants_trajectory"),
    ],
)
def test_it_must_be_announced(tmp_path: Path, teacher: str, said: str) -> None:
    spec = small_spec(tmp_path, teacher=f"odd_teachers:{teacher}")
    with pytest.raises(ValueError, match=f"{said} = True"):
        run(spec, tmp_path / "root")


def test_students_that_cannot_are_refused_beforehand(monkeypatch: pytest.MonkeyPatch) -> None:
    class Simple(STUDENTS.get("ppo")):  # type: ignore[misc]
        """Cannot play without learning."""

        algorithm_version = None
        sample_actions = Student.sample_actions

    monkeypatch.setattr(STUDENTS, "_decorated", {})
    monkeypatch.setattr(STUDENTS, "_origins", {})
    STUDENTS.register("simple")(Simple)
    cell: dict[str, Any] = {"environment": "corridor:Corridor", "embodiment": "", "student": "simple"}
    with pytest.raises(ValueError, match="student 'simple' does not define sample_actions"):
        effective_spec(Cell(teacher="odd_teachers:Watching", **cell), 0, Schedule())
