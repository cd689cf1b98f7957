"""What every teacher of the catalogue promises, over task spaces of many shapes."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from simulated_play import SPACES, play, started

from tma_ray.tasks import KnowledgeLevel, TaskSpace
from tma_ray.teachers import TEACHERS, effective_level

EPISODES = 320  # two fits of the GMM teachers


def test_tasks_and_probes_stay_inside_the_space(teacher_name: str, space: TaskSpace) -> None:
    teacher = started(teacher_name, space)
    tasks = np.stack(play(teacher, EPISODES))
    probes = teacher.probe(100)
    assert tasks.dtype == probes.dtype == np.float32
    assert probes.shape == (100, space.size)
    assert space.contains(tasks)
    assert space.contains(probes)


@pytest.mark.parametrize("seed", [0, 7])
def test_the_seed_alone_determines_the_curriculum(teacher_name: str, space: TaskSpace, seed: int) -> None:
    first = np.stack(play(started(teacher_name, space, seed), EPISODES))
    np.testing.assert_array_equal(first, np.stack(play(started(teacher_name, space, seed), EPISODES)))
    assert not np.array_equal(first, np.stack(play(started(teacher_name, space, seed + 1), EPISODES)))


def test_a_probe_leaves_no_trace(teacher_name: str, space: TaskSpace) -> None:
    probed, quiet = started(teacher_name, space), started(teacher_name, space)
    for part in range(4):
        first, second = probed.probe(10), probed.probe(10)
        np.testing.assert_array_equal(first, second)
        np.testing.assert_array_equal(play(probed, 80, 80 * part), play(quiet, 80, 80 * part))


@pytest.mark.parametrize("episodes", [0, 1, 149, 150, 505])
def test_a_saved_teacher_continues_identically(teacher_name: str, space: TaskSpace, episodes: int) -> None:
    teacher = started(teacher_name, space)
    play(teacher, episodes)
    saved = pickle.dumps(teacher.state())
    expected = np.stack(play(teacher, 200, episodes))
    resumed = started(teacher_name, space, seed=99)  # whatever it drew at start is replaced
    resumed.load_state(pickle.loads(saved))
    resumed.knowledge = teacher.knowledge
    np.testing.assert_array_equal(np.stack(play(resumed, 200, episodes)), expected)


def test_a_saved_teacher_continues_in_a_new_process(teacher_name: str, tmp_path: Path) -> None:
    teacher = started(teacher_name, SPACES["stump_tracks"])
    play(teacher, 160)
    (tmp_path / "state").write_bytes(pickle.dumps(teacher.state()))
    expected = np.stack(play(teacher, 160, 160))
    script = (
        "import pickle, numpy as np; from simulated_play import *\n"
        f"t = started({teacher_name!r}, SPACES['stump_tracks'])\n"
        f"t.load_state(pickle.load(open({str(tmp_path / 'state')!r}, 'rb')))\n"
        f"np.save({str(tmp_path / 'tasks.npy')!r}, np.stack(play(t, 160, 160)))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, cwd=Path(__file__).parent)
    np.testing.assert_array_equal(np.load(tmp_path / "tasks.npy"), expected)


def test_log_rows_fit_the_space(teacher_name: str, space: TaskSpace) -> None:
    teacher = started(teacher_name, space)
    play(teacher, EPISODES)
    for update in teacher.drain_updates():
        for component in update.gaussians:
            assert component.mean.shape == (space.size,)
            assert np.all(np.linalg.eigvalsh(component.covariance) > 0)
        for box in update.boxes:
            assert np.all(box.low <= box.high)
        assert all(np.isfinite(value) for value in update.scalars.values())
    assert teacher.drain_updates() == []


def test_levels_below_the_first_are_refused_by_name(teacher_name: str) -> None:
    teacher = TEACHERS.get(teacher_name)
    for level in KnowledgeLevel:
        if level.rank < teacher.knowledge_levels[0].rank:
            with pytest.raises(ValueError, match=teacher_name):
                effective_level(teacher, teacher_name, level)
        else:
            assert effective_level(teacher, teacher_name, level) in teacher.knowledge_levels
