"""One teacher for worlds that are stepped together, and for those of several processes."""

import functools
import multiprocessing
import os
import signal
import time

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from pendulums import LENGTH, SPACE, curriculum_of, make_pendulum, play, set_task

import tma_ray  # noqa: F401  (registers the environments)
from tma_ray.curriculum import Curriculum
from tma_ray.teachers import TEACHERS

COUNT = 3
OVERLAPPING = [name for name in TEACHERS.names() if TEACHERS.get(name).overlapping]


def episodes_of(worlds: gymnasium.vector.VectorEnv, steps: int) -> list[tuple[list[float], float, bool]]:
    """Play random actions; return tasks, returns and marks of the episodes, in the order of their ends."""
    mode, rng, played = worlds.metadata["autoreset_mode"], np.random.default_rng(0), []
    low, high = worlds.action_space.low, worlds.action_space.high
    _, info = worlds.reset(seed=0)
    tasks, trains = info["task"].copy(), info["trains"].copy()
    returns, over = np.zeros(COUNT), np.zeros(COUNT, bool)
    for _ in range(steps):
        begun = over
        _, rewards, terminated, truncated, info = worlds.step(rng.uniform(low, high).astype(np.float32))
        over = terminated | truncated
        if mode is AutoresetMode.NEXT_STEP:
            tasks[begun], returns[begun] = info.get("task", tasks)[begun], 0.0
            trains[begun] = info["trains"][begun]
        returns += rewards
        last = info.get("final_info", info)
        for row in np.flatnonzero(over):
            assert bool(last["trains"][row]) == trains[row]
            played.append((tasks[row].tolist(), float(returns[row]), bool(trains[row])))
        if over.any() and mode is not AutoresetMode.NEXT_STEP:
            if mode is AutoresetMode.DISABLED:
                _, info = worlds.reset(options={"reset_mask": over.copy()})
            tasks[over], returns[over], trains[over] = info["task"][over], 0.0, info["trains"][over]
    return played


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("kind", ["ours", "sync"])
def test_the_teacher_observes_the_episodes_of_all_worlds(kind: str, mode: AutoresetMode) -> None:
    options = {"mastery_return": 230.0, "values": lambda observations: np.zeros(len(observations))}
    if kind == "ours":
        worlds = gymnasium.make_vec(
            "tma_ray/StumpTracks-v0", COUNT, autoreset_mode=mode, max_episode_steps=30
        )
        space, apply = worlds.unwrapped.envs[0], None
    else:
        worlds = SyncVectorEnv([make_pendulum] * COUNT, autoreset_mode=mode)
        space, apply = SPACE, set_task
    curriculum = Curriculum("robust_plr:buffer_size=3", space, marks_withheld=True, **options)
    wrapped = curriculum.wrap_vector(worlds, apply)
    played = episodes_of(wrapped, 150)
    frame = curriculum.episodes
    assert len(frame) >= 3 * COUNT
    names = [f"task_{name}" for name in curriculum.space.names]
    tasks, returns, trains = zip(*played, strict=True)
    assert frame[names].to_numpy().tolist() == list(tasks)
    np.testing.assert_allclose(frame["episodic_return"], returns)
    assert frame["trains"].tolist() == list(trains)
    assert set(trains) == {True, False}
    wrapped.close()


@pytest.mark.parametrize("name", OVERLAPPING)
def test_every_teacher_of_several_worlds_teaches_them(name: str) -> None:
    curriculum = curriculum_of(name)
    worlds = curriculum.wrap_vector(SyncVectorEnv([make_pendulum] * COUNT), set_task)
    rng = np.random.default_rng(0)
    worlds.reset(seed=0)
    for _ in range(30 * LENGTH):
        worlds.step(rng.uniform(-2, 2, (COUNT, 1)).astype(np.float32))
    assert curriculum.episodes["trains"].sum() >= 20 * COUNT


def test_withheld_episodes_of_our_worlds_are_played_beside_them() -> None:
    worlds = gymnasium.make_vec("tma_ray/StumpTracks-v0", num_envs=2, max_episode_steps=20)
    curriculum = Curriculum(
        "robust_plr:buffer_size=4",
        worlds.unwrapped.envs[0],
        mastery_return=230,
        values=lambda observations: np.zeros(len(observations)),
        act=lambda observations: np.zeros((len(observations), 4), np.float32),
    )
    worlds = curriculum.wrap_vector(worlds)
    worlds.reset(seed=0)
    for _ in range(100):
        worlds.step(worlds.action_space.sample())
    assert set(curriculum.episodes["trains"]) == {True, False}


def test_infos_of_single_worlds_are_arrays_of_truth_where_gymnasium_stacks_them() -> None:
    """Gymnasium stacks Python's `bool` as an array of bool, and NumPy's as one of objects."""
    make = functools.partial(gymnasium.make, "tma_ray/StumpTracks-v0", max_episode_steps=2)
    curriculum = Curriculum("random", make(), mastery_return=230)
    worlds = SyncVectorEnv([lambda: curriculum.wrap(make())] * 2)
    worlds.reset(seed=0)
    infos = [worlds.step(np.zeros((2, 4), np.float32))[4] for _ in range(2)]
    assert {infos[1][key].dtype for key in ("success", "is_success", "trains")} == {np.dtype(np.bool_)}


def test_worlds_that_cannot_be_taught_are_refused() -> None:
    with pytest.raises(ValueError, match=r"num_envs = 3: expected 1, since teacher 'goal_gan'"):
        curriculum_of("goal_gan").wrap_vector(SyncVectorEnv([make_pendulum] * COUNT), set_task)
    alone = curriculum_of("goal_gan")
    alone.begin()
    with pytest.raises(ValueError, match="an episode is under way: end or abandon it"):
        alone.begin()
    worlds = RecordEpisodeStatistics(AsyncVectorEnv([make_pendulum]))
    with pytest.raises(TypeError, match=r"AsyncVectorEnv before any wrapper.*curriculum\.shared\(\)\.wrap"):
        curriculum_of("random").wrap_vector(worlds)
    worlds.close()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_environments_in_processes_are_taught_in_any_mode(mode: AutoresetMode) -> None:
    curriculum = curriculum_of("riac")
    worlds = AsyncVectorEnv([make_pendulum] * 2, copy=False, context="fork", autoreset_mode=mode)
    taught = curriculum.wrap_vector(worlds, set_task)
    assert (taught.copy, taught.context, taught.autoreset_mode) == (False, "fork", mode)
    taught.reset(seed=0)
    for _ in range(2 * (LENGTH + 1)):
        *_, terminated, truncated, _ = taught.step(taught.action_space.sample())
        if mode is AutoresetMode.DISABLED and (over := terminated | truncated).any():
            taught.reset(options={"reset_mask": over})
    taught.close()
    assert curriculum.episodes["length"].tolist() == [LENGTH] * 4
    assert len(curriculum.episodes.drop_duplicates("task_mass")) == 4


@pytest.mark.parametrize(("context", "host"), [("fork", None), ("spawn", None), ("fork", "127.0.0.1")])
def test_processes_share_one_teacher(context: str, host: str | None) -> None:
    curriculum = curriculum_of("robust_plr:buffer_size=6")
    handle = curriculum.shared(host)
    assert isinstance(handle._address, str) == (host is None)
    worlds = AsyncVectorEnv([lambda: handle.wrap(make_pendulum(), set_task)] * 2, context=context)
    worlds.reset(seed=0)
    for _ in range(8 * (LENGTH + 1)):
        worlds.step(worlds.action_space.sample())
    worlds.close()
    frame = curriculum.episodes
    assert frame["trains"].sum() == 16
    assert not frame["trains"].all()


def play_until_killed(handle, begun) -> None:
    environment = handle.wrap(make_pendulum(), set_task)
    environment.reset(seed=0)
    environment.step(np.zeros(1, np.float32))
    begun.set()
    time.sleep(60)


def test_a_process_that_dies_costs_its_episode_only() -> None:
    curriculum = curriculum_of("goal_gan")  # which teaches no other world meanwhile
    handle, context = curriculum.shared(), multiprocessing.get_context("spawn")
    begun = context.Event()
    process = context.Process(target=play_until_killed, args=(handle, begun))
    process.start()
    assert begun.wait(60)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    for _ in range(500):
        if not curriculum._open:
            break
        time.sleep(0.01)
    play(curriculum.wrap(make_pendulum(), set_task), 2)
    assert len(curriculum.episodes) == 2


def test_what_the_curriculum_refuses_is_an_error_of_the_process_that_asked() -> None:
    handle = curriculum_of("goal_gan").shared()
    assignment = handle.begin()
    with pytest.raises(RuntimeError, match="ValueError: an episode is under way"):
        handle.begin()
    handle.abandon(assignment.number)
    assert SPACE.contains(handle.begin().task)


def fork_and_begin(curriculum, results) -> None:
    try:
        curriculum.begin()
    except RuntimeError as error:
        results.put(str(error))


def test_a_forked_copy_teaches_nobody() -> None:
    curriculum, context = curriculum_of("random"), multiprocessing.get_context("fork")
    results = context.Queue()
    process = context.Process(target=fork_and_begin, args=(curriculum, results))
    process.start()
    assert "curriculum.shared()" in results.get(timeout=60)
    process.join()
