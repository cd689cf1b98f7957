from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_runs import TEACHERS, data_files, new_run, one_episode, rows, run, small_spec, stump_tracks_spec

from tma_ray.envs import make_environment
from tma_ray.results import Committer, RunStatus, Table
from tma_ray.runs.evaluation import Evaluation
from tma_ray.runs.spec import Streams, evaluation_seeds


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    run(small_spec(folder, teacher="alp_gmm"), folder / "root")
    return folder


def test_the_schedule_is_kept(finished: Path) -> None:
    root = finished / "root"
    assert sorted({row["step"] for row in rows(root, Table.EVALUATIONS)}) == [0, 1000, 2000, 3000]
    assert sorted({row["step"] for row in rows(root, Table.CURRICULUM)}) == list(range(0, 3001, 500))
    assert [row["sample"] for row in rows(root, Table.CURRICULUM)[:10]] == list(range(10))
    (policy,) = (root / "policies").iterdir()
    assert {path.name for path in policy.iterdir()} == {"policy.json", "policy.safetensors", "spec.json"}


def test_training_windows_summarise_the_episodes(finished: Path) -> None:
    episodes = rows(finished / "root", Table.EPISODES)
    windows = rows(finished / "root", Table.TRAINING)
    assert sum(window["episodes"] for window in windows) == len(episodes)
    for window in windows:
        own = [each for each in episodes if window["step"] - 1000 < each["step"] <= window["step"]]
        returns = [each["episodic_return"] for each in own]
        assert window["episodes"] == len(returns)
        assert window["mean_return"] == pytest.approx(np.mean(returns))
        assert window["std_return"] == pytest.approx(np.std(returns))
    assert np.all(np.diff([episode["step"] for episode in episodes]) > 0)


def test_a_finished_run_is_not_run_again(finished: Path) -> None:
    before = data_files(finished / "root")
    assert run(small_spec(finished, teacher="alp_gmm"), finished / "root", stop_after=1) == "done"
    assert data_files(finished / "root") == before
    assert len(rows(finished / "root", Table.ATTEMPTS)) == 1


def test_a_shorter_run_is_a_prefix_and_looking_changes_nothing(finished: Path, tmp_path: Path) -> None:
    other = small_spec(tmp_path, teacher="alp_gmm", steps=2000, evaluation_interval=700, probe_interval=300)
    run(other, tmp_path / "root")
    long, short = rows(finished / "root", Table.EPISODES), rows(tmp_path / "root", Table.EPISODES)
    assert len(short) > 5
    for row, expected in zip(short, long, strict=False):
        del row["run_id"], expected["run_id"]
        assert row == expected


@pytest.mark.parametrize("view", [False, True])
def test_observations_may_be_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, view: bool) -> None:
    """The student learns the same from one array as from new ones, and SPDL keeps first observations."""
    import corridor

    spec = small_spec(tmp_path, student="sac", teacher="spdl", steps=1_000)
    run(spec, tmp_path / "new")
    observe = corridor.Corridor._observe

    def overwrite(world: corridor.Corridor) -> np.ndarray:
        array: np.ndarray = vars(world).setdefault("array", np.zeros(3, np.float32))
        array[:] = observe(world)
        return array[:] if view else array

    monkeypatch.setattr(corridor.Corridor, "_observe", overwrite)
    run(spec, tmp_path / "overwritten")
    assert data_files(tmp_path / "overwritten") == data_files(tmp_path / "new")


@pytest.mark.parametrize("teacher", sorted(TEACHERS))
def test_returns_are_always_finite(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, teacher: str) -> None:
    """The run names the episode and its task, in the same words for all teachers."""
    import corridor

    step = corridor.Corridor.step

    def rewarded(world: corridor.Corridor, action: np.ndarray) -> tuple:
        observation, _, *rest = step(world, action)
        return observation, float("nan"), *rest

    monkeypatch.setattr(corridor.Corridor, "step", rewarded)
    short = new_run(small_spec(tmp_path, teacher=teacher), tmp_path / "root")
    message = r"episode .* at step \d+, on task \[[-\d., e]+\], has the return nan: expected a finite number"
    with pytest.raises(ValueError, match=message):
        short.advance()


def test_seeds_differ_and_zero_is_one(tmp_path: Path) -> None:
    first = small_spec(tmp_path, seed=0)
    streams = [Streams.of(replace(first, seed=seed)) for seed in (0, 1)]
    parts = [getattr(each, name) for each in streams for name in ("teacher", "environment", "student")]
    draws = {int(np.random.default_rng(part).integers(2**62)) for part in parts}
    assert len(draws) == 6
    with pytest.raises(ValueError, match="seed = -1"):
        replace(first, seed=-1)


def swing(observations: np.ndarray) -> np.ndarray:
    """A policy without randomness, whose actions depend on every observation."""
    return np.tanh(5 * np.sin(observations[:, :4] * 7 + observations[:, 4:8])).astype(np.float32)


def test_lock_step_equals_one_task_after_the_other(tmp_path: Path) -> None:
    spec = stump_tracks_spec(tmp_path, "ppo", "random")
    evaluation = Evaluation(spec)
    together, again = ([(row["length"], row["episodic_return"]) for row in evaluation(swing)] for _ in "12")
    assert again == together
    environment = make_environment(spec.environment, **spec.environment_options)
    tasks = zip(spec.test_set.tasks, evaluation_seeds(spec.test_set), strict=True)
    assert together == [one_episode(environment, swing, task, seed) for task, seed in tasks]


@pytest.mark.parametrize("student", ["ppo", pytest.param("sac", marks=pytest.mark.slow)])
@pytest.mark.parametrize("teacher", ["Inquisitive", "Scrutinising"])
def test_queries_are_answered_without_disturbing_training(tmp_path: Path, student: str, teacher: str) -> None:
    names = (f"odd_teachers:{teacher}", "random")
    asked, silent = (small_spec(tmp_path, student, teacher=name, steps=1_000) for name in names)
    same_streams = replace(silent, plugins={})
    vars(asked)["entropy"] = vars(same_streams)["entropy"] = 1
    run(asked, tmp_path / "asked")
    run(same_streams, tmp_path / "silent")
    episodes = (rows(tmp_path / name, Table.EPISODES) for name in ("asked", "silent"))
    returns, undisturbed = ([row["episodic_return"] for row in each] for each in episodes)
    assert returns == undisturbed
    if teacher == "Scrutinising":  # which logs how many of its queries have been answered
        heard = [dict(row["scalars"])["heard"] for row in rows(tmp_path / "asked", Table.TEACHER_LOG)]
        assert heard == list(range(1, len(returns) + 1))


def test_a_teacher_that_leaves_its_space_fails_the_run_by_name(tmp_path: Path) -> None:
    spec = small_spec(tmp_path, teacher="odd_teachers:Outsider")
    with pytest.raises(ValueError, match="teacher 'odd_teachers:Outsider' left its task space"):
        run(spec, tmp_path / "root")
    manifest = Committer.open(tmp_path / "root").manifest(spec.run_id)
    assert manifest.status is RunStatus.FAILED
    assert "Outsider" in str(manifest.error)
