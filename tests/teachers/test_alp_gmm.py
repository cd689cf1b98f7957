from __future__ import annotations

import pickle

import numpy as np
import pytest
from simulated_play import SPACES, play, started

from tma_ray.tasks import Episode, KnowledgeLevel
from tma_ray.teachers import effective_level, make_teacher
from tma_ray.teachers.alp_gmm import ALPGMM, AbsoluteLearningProgress, NearestReturn
from tma_ray.teachers.mixtures import Mixture, fit_mixture

STUMP_TRACKS = SPACES["stump_tracks"]


def test_nearest_return_equals_a_search_through_everything() -> None:
    rng = np.random.default_rng(0)
    history, tasks, returns = NearestReturn(2, rebuild_every=50), [], []
    for index in range(230):
        task = rng.random(2).astype(np.float32)
        if tasks:
            distances = np.linalg.norm(np.array(tasks) - task, axis=1)
            assert history.nearest(task) == returns[int(np.argmin(distances))]
        if index == 120:
            history = pickle.loads(pickle.dumps(history))
        tasks.append(task.astype(np.float64))
        returns.append(float(rng.normal()))
        history.add(task, returns[-1])


def test_progress_is_the_absolute_difference_once_six_tasks_are_known() -> None:
    progress = AbsoluteLearningProgress(1)
    tasks = [np.array([x], np.float32) for x in (0, 1, 2, 3, 4, 5)]
    assert [progress(task, 10.0) for task in tasks] == [0.0] * 6
    assert progress(np.array([2.1], np.float32), -30.0) == 40.0


def test_the_mixture_finds_separate_clusters() -> None:
    rng = np.random.default_rng(1)
    centres = np.array([[0.0, 0.0, 1.0], [5.0, 5.0, 3.0], [0.0, 9.0, 0.0]])
    rows = np.concatenate([rng.normal(centre, 0.1, (50, 3)) for centre in centres])
    mixture = fit_mixture(rows, 3, seed=0)
    assert len(mixture) == 3
    found = mixture.means[np.lexsort(mixture.means.T[:2])]
    np.testing.assert_allclose(found, centres[np.lexsort(centres.T[:2])], atol=0.1)


def test_components_are_chosen_in_proportion_to_their_mean_progress() -> None:
    teacher = started("alp_gmm", STUMP_TRACKS)
    assert isinstance(teacher, ALPGMM)
    teacher.explore = 0.0
    tiny = np.tile(np.eye(3) * 1e-8, (3, 1, 1))
    means = np.array([[0.5, 1.0, 30.0], [1.5, 3.0, 10.0], [2.5, 5.0, 0.0]])
    teacher.mixture_ = Mixture(np.full(3, 1 / 3), means, tiny)
    heights = np.array([teacher.sample()[0] for _ in range(4000)])
    shares = [np.mean(np.abs(heights - height) < 0.1) for height in (0.5, 1.5, 2.5)]
    np.testing.assert_allclose(shares, [0.75, 0.25, 0.0], atol=0.03)
    means[:, -1] = 0.0
    heights = np.array([teacher.sample()[0] for _ in range(3000)])
    shares = [np.mean(np.abs(heights - height) < 0.1) for height in (0.5, 1.5, 2.5)]
    np.testing.assert_allclose(shares, [1 / 3] * 3, atol=0.04)


def test_bootstrap_is_uniform_unless_the_expert_knows_where_to_start() -> None:
    uniform = np.stack(play(started("alp_gmm", STUMP_TRACKS, level=KnowledgeLevel.LOW), 150))
    informed = np.stack(play(started("alp_gmm", STUMP_TRACKS, level=KnowledgeLevel.HIGH), 150))
    assert uniform[:, 0].mean() == pytest.approx(1.5, abs=0.25)
    assert informed[:, 0].max() < 1.2  # the easy task is the lower corner, its std a tenth of the range
    assert ALPGMM.knowledge_levels == (KnowledgeLevel.NONE, KnowledgeLevel.HIGH)
    assert effective_level(ALPGMM, "alp_gmm", KnowledgeLevel.LOW) is KnowledgeLevel.NONE


def test_it_follows_progress_and_logs_every_fit() -> None:
    teacher = started("alp_gmm", STUMP_TRACKS, level=KnowledgeLevel.NONE)
    for index in range(900):  # only low stumps can be learned
        task = teacher.sample()
        learnable = float(task[0]) < 1.0
        gain = 0.5 * index if learnable else 0.0
        teacher.observe(Episode(task, -100 + gain, False, 10, np.zeros(1, np.float32), 0.0, index))
    updates = teacher.drain_updates()
    assert len(updates) == 6
    assert all(2 <= len(update.gaussians) <= 10 for update in updates)
    assert np.mean(teacher.probe(200)[:, 0] < 1.2) > 0.6


@pytest.mark.parametrize(
    "wrong", [{"fit_every": 2}, {"most_components": 1}, {"explore": 1.5}, {"exploer": 0.1}]
)
def test_impossible_hyperparameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        make_teacher("alp_gmm", wrong)
