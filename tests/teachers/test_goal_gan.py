import numpy as np
import pytest
import torch
from simulated_play import SPACES, ended, started

from tma_ray.tasks import KnowledgeLevel, Task
from tma_ray.teachers.goal_gan import GoalGAN
from tma_ray.teachers.networks import LeastSquaresGAN

STUMP_TRACKS = SPACES["stump_tracks"]


def goal_gan(level: KnowledgeLevel = KnowledgeLevel.HIGH, seed: int = 0, **changes: float) -> GoalGAN:
    return started("goal_gan", STUMP_TRACKS, seed, level, **changes)


def outcome(teacher: GoalGAN, *successes: bool) -> Task:
    """Play one new task, once per success."""
    teacher.old_share = 0.0
    assert not teacher.rollouts_left_
    task = teacher.sample()
    for success in successes:
        np.testing.assert_array_equal(teacher.sample(), task)
        teacher.observe(ended(task, success=success))
    return task


def test_the_discriminator_separates_and_the_generator_follows() -> None:
    rng = np.random.default_rng(0)
    network = LeastSquaresGAN(2, 1e-3, 64, rng)
    points = rng.uniform(-0.5, 0.5, (400, 2))
    wanted = np.linalg.norm(points - [0.3, -0.2], axis=1) < 0.2
    first = network.train(points, wanted, 20, rng)
    last = network.train(points, wanted, 250, rng)
    assert last["discriminator_loss"] < first["discriminator_loss"]
    with torch.no_grad():
        judged = network.discriminator(torch.from_numpy(points.astype(np.float32)))[:, 0].numpy()
    assert np.mean(judged[wanted][:, None] > judged[~wanted]) > 0.9
    generated = network.generate(500, rng)
    assert np.mean(np.linalg.norm(generated - [0.3, -0.2], axis=1) < 0.3) > 0.7


@pytest.mark.slow
@pytest.mark.parametrize("level", [KnowledgeLevel.LOW, KnowledgeLevel.HIGH])
def test_pretraining_brings_generated_tasks_near_the_initial_gaussian(level: KnowledgeLevel) -> None:
    """A generator circles around what it imitates, and rounding decides where; the mean of some is near."""
    errors = []
    for seed in range(4):
        teacher = goal_gan(level, seed, pretraining_iterations=200)
        initial = teacher.knowledge.initial
        expected = STUMP_TRACKS.normalise(initial.sample(STUMP_TRACKS, np.random.default_rng(0), 1000))
        tasks = STUMP_TRACKS.normalise(teacher.probe(1000))
        errors.append([tasks.mean(axis=0) - expected.mean(axis=0), tasks.std(axis=0) - expected.std(axis=0)])
        losses = {"discriminator_loss", "generator_loss"}
        assert teacher.drain_updates()[0].scalars.keys() == losses | {"buffer_size"}
    np.testing.assert_allclose(np.mean(errors, axis=0), 0, atol=0.06)
    np.testing.assert_allclose(errors, 0, atol=0.2)


def test_a_new_task_is_wanted_with_exactly_one_success_out_of_two() -> None:
    teacher = goal_gan()
    for successes in ((False, False), (True, False), (False, True), (True, True)):
        outcome(teacher, *successes)
    assert [wanted for _, wanted in teacher.labelled_] == [False, True, True, False]
    more = goal_gan(rollouts=4)
    for count in range(5):
        outcome(more, *(index < count for index in range(4)))
    assert [wanted for _, wanted in more.labelled_] == [False, True, True, True, False]
    assert len({tuple(point) for point, _ in more.labelled_}) == 5


def test_the_buffer_takes_wanted_tasks_that_are_far_from_all_others() -> None:
    teacher = goal_gan(noise=0.3)
    stored: list[np.ndarray] = []
    for index in range(200):
        wanted = index % 3 != 0
        point = STUMP_TRACKS.normalise(outcome(teacher, wanted, False))
        near = any(np.linalg.norm(point - other) <= 0.1 * np.sqrt(2) for other in stored)
        if wanted and not near:
            stored.append(point)
    np.testing.assert_array_equal(teacher.buffer_, stored)
    assert 5 < len(stored) < 100


def test_buffered_tasks_are_played_once_and_never_labelled() -> None:
    teacher = goal_gan(old_share=1.0, train_every=10_000)
    teacher.buffer_ = np.array([[0.5, 0.5]])
    tasks = []
    for _ in range(100):
        tasks.append(teacher.sample())
        teacher.observe(ended(tasks[-1], success=True))
    assert teacher.labelled_ == []
    assert len(np.unique(tasks, axis=0)) == 100
    np.testing.assert_allclose(np.mean(tasks, axis=0), [1.5, 3.0], atol=0.03)
    np.testing.assert_allclose(np.std(tasks, axis=0), 0.01 * STUMP_TRACKS.width, rtol=0.3)


def test_a_fifth_of_the_choices_falls_on_the_buffer() -> None:
    teacher = goal_gan(train_every=10_000)
    teacher.buffer_ = np.array([[0.5, 0.5]])
    choices = 0
    while choices < 1000:
        choices += not teacher.rollouts_left_
        teacher.observe(ended(teacher.sample(), success=False))
    assert len(teacher.labelled_) == pytest.approx(800, abs=45)


def test_without_a_wanted_task_the_network_stays_as_it_is() -> None:
    teacher = goal_gan()
    before = teacher.probe(50)
    teacher.drain_updates()
    for _ in range(teacher.train_every):
        teacher.observe(ended(teacher.sample(), success=False))
    assert teacher.labelled_ == []
    scalars = teacher.drain_updates()[0].scalars
    assert scalars == {"wanted_share": 0.0, "buffer_size": 0.0}
    state = teacher.network_.generate(50, np.random.default_rng(5))
    np.testing.assert_array_equal(state, goal_gan().network_.generate(50, np.random.default_rng(5)))
    assert STUMP_TRACKS.contains(before)


@pytest.mark.slow
def test_it_follows_a_student_that_gets_better() -> None:
    """Tasks half a step around the student's skill succeed now and then, lower ones always."""
    teacher = goal_gan(pretraining_iterations=200, iterations_per_task=1.5, noise=0.05)
    assert teacher.probe(300)[:, 0].mean() < 0.5
    rng = np.random.default_rng(0)
    for index in range(2000):
        task, skill = teacher.sample(), 0.2 + 1.3 * index / 2000
        teacher.observe(ended(task, success=bool(rng.random() < 0.5 + skill - task[0])))
    assert np.mean(np.abs(teacher.probe(300)[:, 0] - skill) < 0.5) > 0.8
    scalars = [update.scalars for update in teacher.drain_updates()]
    assert np.mean([row["wanted_share"] for row in scalars[-5:]]) > 0.25
    assert scalars[-1]["buffer_size"] > 3
