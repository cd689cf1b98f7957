"""Every teacher teaches in a loop of somebody else, and continues bit for bit what was saved."""

import copy
import pickle
from pathlib import Path

import gymnasium
import numpy as np
import pandas as pd
import pytest
from pendulums import (
    LENGTH,
    MASTERY_RETURN,
    SPACE,
    act,
    curriculum_of,
    functions,
    make_pendulum,
    play,
    set_task,
    values,
)

import analysis
from tma_ray.cli import main
from tma_ray.curriculum import Curriculum, TaskEvaluation, teacher_needs
from tma_ray.tasks import Episode, Gaussian
from tma_ray.teachers import TEACHERS, Teacher
from tma_ray.teachers.alp_gmm import ALPGMM

SMALL = {name: f"{name}:buffer_size=10" for name in ("plr", "robust_plr", "accel", "traced")}
SMALL |= {"sfl": "sfl:candidates=3:rollouts=2:kept=2", "alp_gmm": "alp_gmm:fit_every=10"}
"""Teachers with settings by which a short test reaches all that they do."""

EVERY_TEACHER = [SMALL.get(name, name) for name in TEACHERS.names()]


@pytest.mark.parametrize("teacher", EVERY_TEACHER)
def test_what_was_saved_continues_bit_for_bit(teacher: str, tmp_path: Path) -> None:
    curriculum = curriculum_of(teacher)
    play(curriculum.wrap(make_pendulum(), set_task), 25)
    curriculum.save(tmp_path / "saved")
    curriculum.save(tmp_path / "saved")  # replaces the first
    loaded = Curriculum.load(tmp_path / "saved", **functions())
    expected, given = (play(one.wrap(make_pendulum(), set_task), 15, seed=50) for one in (curriculum, loaded))
    assert given == expected
    pd.testing.assert_frame_equal(loaded.episodes, curriculum.episodes)


@pytest.mark.parametrize("teacher", EVERY_TEACHER)
def test_episodes_that_must_not_train_stay_outside_of_the_loop(teacher: str) -> None:
    curriculum = curriculum_of(teacher)
    played = play(curriculum.wrap(make_pendulum(), set_task), 30)
    frame = curriculum.episodes
    trained = frame[frame["trains"]]
    assert trained[["task_mass", "task_length"]].to_numpy().tolist() == [task for task, _ in played]
    np.testing.assert_allclose(trained["episodic_return"], [value for _, value in played])
    assert TEACHERS.get(teacher.split(":")[0]).withholds_episodes == (len(trained) < len(frame))
    assert (trained["success"] == (trained["episodic_return"] > MASTERY_RETURN)).all()
    assert (frame["length"] == LENGTH).all()


def test_a_loop_may_play_the_episodes_that_must_not_train_by_their_marks() -> None:
    with pytest.raises(ValueError, match=r"needs act= \(or marks_withheld=True\)"):
        Curriculum(SMALL["robust_plr"], SPACE, mastery_return=MASTERY_RETURN, values=values)
    needs = {"mastery_return": MASTERY_RETURN, "values": values}
    curriculum = Curriculum(SMALL["robust_plr"], SPACE, **needs, marks_withheld=True)
    environment, marks = curriculum.wrap(make_pendulum(), set_task), []
    for _ in range(30):
        _, info = environment.reset(seed=0)
        steps = [environment.step(np.zeros(1, np.float32))[4]["trains"] for _ in range(LENGTH)]
        assert steps == [info["trains"]] * LENGTH
        marks.append(info["trains"])
    assert curriculum.episodes["trains"].tolist() == marks
    assert set(marks) == {True, False}


class Listener(Teacher):
    def sample(self) -> np.ndarray:
        self.episodes_ = getattr(self, "episodes_", [])
        return self.space.sample(self.rng)

    def observe(self, episode: Episode) -> None:
        self.episodes_.append(episode)


def test_the_teacher_observes_what_was_played_and_nothing_of_abandoned_episodes() -> None:
    curriculum = Curriculum(Listener, SPACE, mastery_return=MASTERY_RETURN, gamma=0.5)
    environment = curriculum.wrap(make_pendulum(), set_task)
    environment.reset(seed=0)
    environment.step(np.zeros(1, np.float32))  # abandoned
    first, info = environment.reset(seed=1)
    assert environment.unwrapped.m == info["task"][0]
    rewards = [environment.step(np.zeros(1, np.float32))[1] for _ in range(LENGTH)]
    environment.reset(seed=2)
    (episode,) = curriculum._teacher.episodes_
    assert episode.task.tolist() == info["task"].tolist()
    assert episode.initial_observation.tolist() == first.tolist()
    assert episode.episodic_return == pytest.approx(sum(rewards))
    assert episode.discounted_return == pytest.approx(sum(0.5**step * r for step, r in enumerate(rewards)))
    assert (episode.length, episode.step, curriculum.steps) == (LENGTH, LENGTH, LENGTH)


def test_a_curriculum_is_what_a_teacher_proposes_alone() -> None:
    """The same tasks as of a teacher that a loop drives by hand."""
    curriculum = curriculum_of("riac", seed=3)
    played = play(curriculum.wrap(make_pendulum(), set_task), 40)
    again = curriculum_of(TEACHERS.get("riac")(), seed=3)
    teacher, tasks = again._teacher, []
    for number, (_, episodic_return) in enumerate(played, 1):
        task = teacher.propose().task
        tasks.append(task.tolist())
        mastered = episodic_return > MASTERY_RETURN
        teacher.observe(Episode(task, episodic_return, mastered, LENGTH, np.zeros(3), 0.0, LENGTH * number))
    assert tasks == [task for task, _ in played]


@pytest.mark.parametrize("name", TEACHERS.names())
def test_a_teacher_is_refused_without_what_it_needs(name: str) -> None:
    needs = teacher_needs().set_index("teacher").loc[name]
    options = {"mastery_return": MASTERY_RETURN, "expert_knowledge": "high", "easy_task": np.array([1, 1])}
    given = {need: functions()[need] for need in filter(None, needs["needs"].split(", "))}
    Curriculum(name, SPACE, **options, **given)
    if given:
        with pytest.raises(ValueError, match=f"needs {next(iter(given))}=.*without such needs: adr, alp_gmm"):
            Curriculum(name, SPACE, **options)


@pytest.mark.parametrize(
    ("teacher", "space", "options", "message"),
    [
        ("alp_gm", SPACE, {}, "alp_gmm"),
        ("alp_gmm:fit_ever=1", SPACE, {}, "fit_every"),
        (7, SPACE, {}, "expected a name, a class or an instance of Teacher"),
        ("alp_gmm", gymnasium.make("Pendulum-v1"), {}, "task_space"),
        ("alp_gmm", SPACE, {"mastery_return": np.nan}, "mastery_return = nan: expected a finite number"),
        ("adr", SPACE, {}, "needs at least 'low'"),
        ("alp_gmm", SPACE, {"expert_knowledge": "some"}, "some"),
        ("alp_gmm", SPACE, {"seed": -1}, "seed"),
    ],
)
def test_what_makes_no_curriculum_is_refused(teacher, space, options, message) -> None:
    with pytest.raises((ValueError, TypeError, AttributeError, KeyError), match=message):
        Curriculum(teacher, space, **{"mastery_return": MASTERY_RETURN} | options)
    with pytest.raises(TypeError, match="mastery_return"):
        Curriculum("alp_gmm", SPACE)


def test_knowledge_may_be_given() -> None:
    target = Gaussian(np.array([2.0, 1.5]), np.array([1e-6, 1e-6]))
    easy = np.array([0.5, 0.5])
    known = {"expert_knowledge": "high", "easy_task": easy, "target": target}
    curriculum = Curriculum("spdl", SPACE, mastery_return=MASTERY_RETURN, values=values, **known)
    knowledge = curriculum._teacher.knowledge
    assert (knowledge.initial.mean.tolist(), knowledge.target) == (easy.tolist(), target)
    assert knowledge.mastery_threshold == MASTERY_RETURN


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda observations: observations, r"shape \(11, 3\) for 11 observations"),
        (lambda observations: np.full(len(observations), np.nan), "one finite number each"),
    ],
)
def test_values_of_another_shape_are_refused(answer, message: str) -> None:
    curriculum = Curriculum("plr", SPACE, mastery_return=0, values=answer)
    with pytest.raises(ValueError, match=message):
        play(curriculum.wrap(make_pendulum(), set_task), 1)


def test_an_instance_is_copied_and_a_wrapper_has_its_spec() -> None:
    teacher = ALPGMM(fit_every=20)
    curriculum = Curriculum(teacher, {"mass": (0.5, 2.0)}, mastery_return=0)
    curriculum.begin()
    assert not hasattr(teacher, "space")
    environment = curriculum.wrap(make_pendulum(), set_task)
    assert environment.spec.id == "Pendulum-v1"


def test_evaluations_of_tasks_are_episodes_of_a_copy() -> None:
    evaluate = TaskEvaluation(make_pendulum, act, SPACE, -10.0, apply=set_task, seed=3)
    outcomes = evaluate(np.array([[1, 1], [2, 1.5]], np.float32), False)
    environment = make_pendulum()
    set_task(environment, {"mass": 1, "length": 1})
    environment.reset(seed=3)
    expected = sum(environment.step(np.zeros(1, np.float32))[1] for _ in range(LENGTH))
    assert outcomes.episodic_returns[0] == pytest.approx(expected)
    assert outcomes.successes.tolist() == (outcomes.episodic_returns > -10.0).tolist()
    assert outcomes.lengths.tolist() == [LENGTH, LENGTH]


def test_a_copy_is_a_handle_of_the_same_curriculum() -> None:
    curriculum = curriculum_of("alp_gmm")
    environment = curriculum.wrap(make_pendulum(), set_task)
    for other in (pickle.loads(pickle.dumps(environment)), copy.deepcopy(environment)):
        before = len(curriculum.episodes)
        play(other, 2)
        assert len(curriculum.episodes) == before + 2
        other.close()


def test_the_record_is_read_as_other_results(tmp_path: Path) -> None:
    curriculum = curriculum_of("alp_gmm:fit_every=10")
    play(curriculum.wrap(make_pendulum(), set_task), 30)
    curriculum.save(tmp_path / "saved")
    frames = analysis.load(tmp_path / "saved")
    (run_id,) = frames.cells["run_id"]
    episodes = frames.episodes(run_id).sort_values("step")
    assert episodes["episodic_return"].tolist() == curriculum.episodes["episodic_return"].tolist()
    tasks = curriculum.episodes[["task_mass", "task_length"]].to_numpy()
    assert np.stack(episodes["task"]).tolist() == tasks.tolist()
    assert len(frames.teacher_log(run_id)) == 3
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("of somebody")
    with pytest.raises(FileExistsError, match="something else than a saved curriculum"):
        curriculum.save(tmp_path / "other")
    assert (tmp_path / "other" / "file").read_text() == "of somebody"


@pytest.mark.slow
def test_figures_and_the_report_show_the_record(tmp_path: Path) -> None:
    curriculum = curriculum_of("alp_gmm:fit_every=10")
    play(curriculum.wrap(make_pendulum(), set_task), 30)
    curriculum.save(tmp_path / "saved")
    for command in ("figures", "report"):
        assert main([command, str(tmp_path / "saved"), "--output", str(tmp_path / command)]) == 0
    assert list((tmp_path / "figures").glob("*-training-tasks.png"))
    assert "ALP-GMM" in (tmp_path / "report" / "index.html").read_text()
