"""Vector environments play what their worlds would play alone, bit for bit, on tasks of their own."""

import copy
import gc
import itertools
import multiprocessing
import pickle
import subprocess
import sys
import threading
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector as wrappers

import tma_ray  # noqa: F401  (registers the environments)
from tma_ray.envs import ENVIRONMENTS, make_environment, make_vector_environment
from tma_ray.envs.vector import EngineLockStep, LockStep, VectorEnvironment, lock_step
from tma_ray.physics import engine_in_use
from tma_ray.physics.compiled.step import body_in

COUNT = 4
IDS = {"stump_tracks": "tma_ray/StumpTracks-v0", "parkour": "tma_ray/Parkour-v0"}
DISABLED = AutoresetMode.DISABLED


def one_by_one(name: str, mode: AutoresetMode) -> SyncVectorEnv:
    """Gymnasium's own vector environment of single worlds."""
    return SyncVectorEnv([lambda: make_environment(name)] * COUNT, autoreset_mode=mode)


def same(given, expected) -> bool:
    """Tell whether two results, or dicts of arrays, are the same bits."""
    if isinstance(expected, dict):
        return given.keys() == expected.keys() and all(same(given[key], expected[key]) for key in expected)
    if expected is None or given is None:
        return given is expected
    if expected.dtype == object:
        return given.dtype == object and all(map(same, given, expected))
    return given.dtype == expected.dtype and given.tobytes() == expected.tobytes()


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("name", IDS)
def test_worlds_equal_gymnasiums_own_in_every_mode(name: str, mode: AutoresetMode, threads: int) -> None:
    """Episodes begin when others are under way: since they ended, and by force."""
    options = {"threads": threads, "autoreset_mode": mode, "max_episode_steps": 100}
    worlds = gymnasium.make_vec(IDS[name], num_envs=COUNT, **options)
    assert isinstance(worlds.unwrapped, VectorEnvironment)
    assert worlds.metadata["autoreset_mode"] is worlds.unwrapped.autoreset_mode is mode
    expected = one_by_one(name, mode)
    expected.set_attr("max_episode_steps", 100)
    rng, mask, ends = np.random.default_rng(0), np.ones(COUNT, np.bool_), 0
    seed: int | None = 7
    for step in range(500):
        if mask.any():
            both = (worlds, expected)
            results = tuple(each.reset(seed=seed, options={"reset_mask": mask.copy()}) for each in both)
            assert all(same(given, wanted) for given, wanted in zip(*results, strict=True))
            seed = None
        actions = rng.uniform(-1, 1, worlds.action_space.shape).astype(np.float32)
        results = worlds.step(actions), expected.step(actions)
        assert all(same(given, wanted) for given, wanted in zip(*results, strict=True)), step
        over = results[0][2] | results[0][3]
        ends += int(over.sum())
        mask = rng.random(COUNT) < 0.005
        if mode is DISABLED:
            mask |= over
    assert ends > 2 * COUNT


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_function_of_tasks_chooses_those_of_all_episodes_without_a_given_one(mode: AutoresetMode) -> None:
    tasks = ({"stump_height": 0.1 * number, "obstacle_spacing": 5.0} for number in itertools.count())
    options = {"autoreset_mode": mode, "max_episode_steps": 3}
    worlds = make_vector_environment("stump_tracks", 2, next_task=lambda: next(tasks), **options)
    still = np.zeros((2, 4), np.float32)
    heights = [worlds.reset(seed=0)[1]["task"][:, 0]]
    heights += [worlds.step(still)[4]["task"][:, 0] for _ in range(9)]
    length = 4 if mode is AutoresetMode.NEXT_STEP else 3
    expected = [[0.2 * (step // length), 0.2 * (step // length) + 0.1] for step in range(10)]
    np.testing.assert_allclose(heights, expected, rtol=1e-6)
    _, info = worlds.reset(options={"task": {"stump_height": [1.0, 2.0], "obstacle_spacing": 4.0}})
    assert info["task"].tolist() == [[1, 4], [2, 4]]


def test_a_refused_task_of_the_function_moves_no_world_and_can_be_tried_again() -> None:
    tasks = iter([[0, 5], [0, 5], [99, 5], [0, 5], [0, 5], [0, 5]])
    options = {"max_episode_steps": 1, "autoreset_mode": "NextStep"}
    worlds = make_vector_environment("stump_tracks", 2, next_task=lambda: next(tasks), **options)
    still = np.zeros((2, 4), np.float32)
    worlds.reset(seed=0)
    assert worlds.step(still)[3].all()
    with pytest.raises(ValueError, match="stump_height = 99 is outside"):
        worlds.step(still)
    assert not worlds.step(still)[3].any()


def test_attributes_of_the_worlds_are_read_and_set() -> None:
    worlds = make_vector_environment("stump_tracks", 2, autoreset_mode=DISABLED)
    assert worlds.get_attr("max_episode_steps") == worlds.call("get_wrapper_attr", "max_episode_steps")
    worlds.reset(seed=0)
    worlds.set_attr("max_episode_steps", [2, 3])
    still = np.zeros((2, 4), np.float32)
    assert [worlds.step(still)[3].tolist() for _ in range(2)] == [[False, False], [True, False]]
    with pytest.raises(ValueError, match="3 values of mastery_return for 2 worlds"):
        worlds.set_attr("mastery_return", [1, 2, 3])
    worlds.set_attr("mastery_return", -300)
    worlds.reset()
    assert worlds.step(still)[4]["success"].all()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_gymnasiums_vector_wrappers_accept_the_worlds(mode: AutoresetMode) -> None:
    """They count episodes as of Gymnasium's own vector: before 1.4 in SAME_STEP, one step less."""
    make = partial(gymnasium.make, IDS["stump_tracks"], max_episode_steps=10)
    ours = gymnasium.make_vec(IDS["stump_tracks"], num_envs=2, autoreset_mode=mode, max_episode_steps=10)
    ends = []
    for worlds in (ours, SyncVectorEnv([make, make], autoreset_mode=mode)):
        wrapped = wrappers.NormalizeReward(wrappers.ClipAction(wrappers.RecordEpisodeStatistics(worlds)))
        if mode is AutoresetMode.NEXT_STEP:  # which those of observations accept, beside DISABLED
            wrapped = wrappers.NormalizeObservation(wrapped)
        wrapped.reset(seed=0)
        infos = [wrapped.step(np.full((2, 4), 2.0, np.float32))[4] for _ in range(35)]
        ends.append([(n, info["episode"]["l"].tolist()) for n, info in enumerate(infos) if "episode" in info])
    assert ends[0] == ends[1]
    period = 11 if mode is AutoresetMode.NEXT_STEP else 10
    assert [step for step, _ in ends[0]] == [9, 9 + period, 9 + 2 * period]
    assert ends[0][0] == (9, [10, 10])


def test_each_world_is_truncated_by_its_own_counter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tma_ray.envs.stump_tracks.StumpTracks.max_episode_steps", 20)
    worlds = make_vector_environment("stump_tracks", 2, autoreset_mode=DISABLED)
    still = np.zeros(worlds.action_space.shape, np.float32)
    worlds.reset(seed=0, options={"task": np.zeros((2, 2))})
    ends = []
    for step in range(45):
        if step == 10:
            worlds.reset(options={"reset_mask": np.array([False, True]), "task": np.zeros((2, 2))})
        *_, terminated, truncated, _ = worlds.step(still)
        ends += [(step, row) for row in np.flatnonzero(terminated | truncated)]
        if (terminated | truncated).any():
            assert truncated.any()
            worlds.reset(options={"reset_mask": truncated, "task": np.zeros((2, 2))})
    assert ends == [(19, 0), (29, 1), (39, 0)]


def test_every_world_has_the_task_that_it_is_given() -> None:
    worlds, tasks = make_vector_environment("stump_tracks", 3), np.array([[0, 6], [0.1, 3], [3, 0]])
    observations, info = worlds.reset(seed=1, options={"task": tasks})
    np.testing.assert_array_equal(info["task"], tasks.astype(np.float32))
    assert info["task"].dtype == np.float32
    for row, task in enumerate(tasks):
        alone, single = make_environment("stump_tracks").reset(seed=1 + row, options={"task": task})
        np.testing.assert_array_equal(info["task"][row], single["task"], strict=True)
        assert observations[row].tobytes() == alone.tobytes()
    others = tasks[::-1].copy()
    first = np.array([True, False, False])
    after, info = worlds.reset(seed=[9, 9, 9], options={"task": others, "reset_mask": first})
    assert info["_task"].tolist() == [True, False, False]
    assert info["task"][0].tolist() == others[0].tolist()
    assert after[1:].tobytes() == observations[1:].tobytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": np.zeros(2)}, r"tasks have shape \(3, 2\), one row for each world; got \(2,\)"),
        ({"task": [[0, 0], [0, 0], [99, 0]]}, "stump_height = 99 is outside its valid domain"),
        ({"tasks": np.zeros((3, 2))}, "unknown reset option 'tasks'"),
        ({"task": {"stump_height": 1.0}}, "expected exactly stump_height, obstacle_spacing"),
        ({"reset_mask": np.zeros(3, np.bool_)}, "at least one of them true"),
        ({"reset_mask": np.ones(2, np.bool_)}, r"expected \(3,\) of bool"),
        ({"reset_mask": [1, 0, 1]}, "type int64"),
    ],
)
def test_malformed_resets_are_refused(options: dict[str, object], message: str) -> None:
    worlds = make_vector_environment("stump_tracks", 3)
    worlds.reset(seed=0)
    with pytest.raises(ValueError, match=message):
        worlds.reset(options=options)
    with pytest.raises(ValueError, match="2 seeds for 3 worlds"):
        worlds.reset(seed=[1, 2])


def test_what_cannot_be_stepped_moves_no_world() -> None:
    worlds = make_vector_environment("stump_tracks", 2, autoreset_mode=DISABLED)
    with pytest.raises(gymnasium.error.ResetNeeded, match="the first reset begins an episode in every world"):
        worlds.reset(options={"reset_mask": np.array([True, False])})
    still = np.zeros((2, 4), np.float32)
    with pytest.raises(gymnasium.error.ResetNeeded, match="worlds 0, 1 have ended or not begun"):
        worlds.step(still)
    worlds.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions have shape \(2, 4\), got \(2, 3\)"):
        worlds.step(still[:, :3])
    with pytest.raises(ValueError, match="actions must be finite"):
        worlds.step(np.full((2, 4), np.nan))
    with pytest.raises(ValueError, match="outside its valid domain"):
        worlds.reset(options={"task": [[0, 0], [99, 0]]})
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
        worlds.step(still)
    worlds.reset(options={"task": np.zeros((2, 2))})
    worlds.step(still)


def test_worlds_without_an_engine_are_stepped_in_turn() -> None:
    worlds = make_vector_environment("swing_up:SwingUp", 2)
    assert not isinstance(worlds._worlds, EngineLockStep)
    worlds.reset(seed=0)
    for _ in range(199):
        *_, truncated, _ = worlds.step(np.zeros((2, 1), np.float32))
        assert not truncated.any()
    assert worlds.step(np.zeros((2, 1), np.float32))[3].all()


def test_worlds_of_pymunk_are_stepped_in_turn_with_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, played = np.random.default_rng(0), []
    actions = rng.uniform(-1, 1, (20, 2, 4)).astype(np.float32)
    for engine in ("compiled", "pymunk"):
        monkeypatch.setenv("TMA_RAY_ENGINE", engine)
        engine_in_use.cache_clear()
        worlds = make_vector_environment("stump_tracks", 2)
        observations = [worlds.reset(seed=3)[0]]
        observations += [worlds.step(each)[0] for each in actions]
        played.append(np.stack(observations).tobytes())
    refusal = r"threads = 2: expected 1 with the pymunk engine \(TMA_RAY_ENGINE=pymunk demands it\)"
    with pytest.raises(ValueError, match=refusal):
        make_vector_environment("stump_tracks", 2, threads=2).reset(seed=3)
    engine_in_use.cache_clear()
    assert played[0] == played[1]


def test_a_vector_is_not_drawn() -> None:
    with pytest.raises(ValueError, match="vectorization_mode='sync'"):
        gymnasium.make_vec(IDS["parkour"], num_envs=2, render_mode="rgb_array")
    assert set(IDS) == set(ENVIRONMENTS.names())


@pytest.mark.parametrize(
    ("name", "body"),
    [
        ("stump_tracks", "classic_bipedal"),
        ("stump_tracks", "spider"),
        ("parkour", "fish"),
        ("parkour", "climbing_chimpanzee"),
    ],
)
def test_any_number_of_threads_gives_the_same_bits(name: str, body: str) -> None:
    options = {"num_envs": COUNT, "embodiment": body, "autoreset_mode": DISABLED}
    options |= {"swinging_creepers": True} if name == "parkour" else {}
    vectors = [gymnasium.make_vec(IDS[name], threads=threads, **options) for threads in (1, 2, COUNT)]
    rng, mask, seed = np.random.default_rng(0), np.ones(COUNT, np.bool_), 3
    for _ in range(60):
        if mask.any():
            results = [worlds.reset(seed=seed, options={"reset_mask": mask}) for worlds in vectors]
            assert all(same(given, results[0][0]) for given, _ in results)
            seed = None
        actions = rng.uniform(-1, 1, vectors[0].action_space.shape).astype(np.float32)
        one, *others = (worlds.step(actions) for worlds in vectors)
        assert all(same(*pair) for other in others for pair in zip(other, one, strict=True))
        mask = one[2] | one[3] | (rng.random(COUNT) < 0.05)


def helpers() -> list[str]:
    """Name of the threads that help to step worlds."""
    return [thread.name for thread in threading.enumerate() if thread.name == "tma_ray worlds"]


def test_threads_live_from_the_first_reset_until_the_vector_is_closed_or_gone() -> None:
    worlds = make_vector_environment("stump_tracks", 3, threads=3)
    still = np.zeros(worlds.action_space.shape, np.float32)
    assert len(helpers()) == 0
    for _ in range(2):  # a reset begins again what was closed
        worlds.reset(seed=0)
        worlds.step(still)
        assert len(helpers()) == 2
        worlds.close_extras()
        assert len(helpers()) == 0
        with pytest.raises(gymnasium.error.ResetNeeded, match="worlds 0, 1, 2 have ended or not begun"):
            worlds.step(still)
    worlds.reset(seed=0)
    del worlds
    gc.collect()
    assert len(helpers()) == 0


def test_the_interpreter_ends_with_worlds_that_nobody_closed() -> None:
    code = (
        "import gymnasium, tma_ray\n"
        f"worlds = gymnasium.make_vec({IDS['stump_tracks']!r}, num_envs=4, threads=2)\n"
        "worlds.reset(seed=0)\n"
        "worlds.step(worlds.action_space.sample())"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=120, check=False)
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_a_fresh_process_makes_worlds_by_an_id_that_names_the_module() -> None:
    code = (
        "import gymnasium, sys\n"
        "worlds = gymnasium.make_vec('tma_ray:tma_ray/StumpTracks-v0', num_envs=2)\n"
        "print(worlds.spec.id, worlds.spec.reward_threshold)"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=120, check=False)
    assert ended.stdout.split() == [b"tma_ray/StumpTracks-v0", b"230.0"], ended.stderr


@pytest.mark.parametrize("row", [0, 3])
def test_a_step_that_fails_in_a_thread_is_an_error_of_the_call(row: int) -> None:
    worlds = make_vector_environment("stump_tracks", 4, threads=2)
    worlds.reset(seed=0)
    still, memory = np.zeros((4, 4), np.float32), worlds._environments[row]._engine._memory
    motors = body_in(*memory).motors
    speeds = motors[:, 1].copy()
    motors[:, 1] = 0.0  # which observations are divided by
    with pytest.raises(RuntimeError, match="the step of a world failed"):
        worlds.step(still)
    motors[:, 1] = speeds
    worlds.step(still)


def test_copies_have_worlds_of_their_own_once_they_are_reset() -> None:
    worlds = gymnasium.make_vec(IDS["stump_tracks"], num_envs=2, threads=2)
    still = np.zeros((2, 4), np.float32)
    worlds.reset(seed=0)
    for copied_by in (copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="in an episode cannot be copied or pickled"):
            copied_by(worlds)
    worlds.close()
    for copied in (copy.deepcopy(worlds), pickle.loads(pickle.dumps(worlds))):
        with pytest.raises(gymnasium.error.ResetNeeded):
            copied.step(still)
        assert copied.spec == worlds.spec
        assert same(copied.reset(seed=5)[0], worlds.reset(seed=5)[0])
        assert same(copied.step(still)[0], worlds.step(still)[0])


def test_a_forked_process_steps_its_copies_alone() -> None:
    worlds = make_vector_environment("stump_tracks", 4, threads=2)
    worlds.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (20, 4, 4)).astype(np.float32)

    def play(results) -> None:
        results.put([worlds.step(action)[0].tobytes() for action in actions])

    context = multiprocessing.get_context("fork")
    seen = context.Queue()
    child = context.Process(target=play, args=(seen,))
    child.start()
    forked = seen.get(timeout=60)
    child.join(60)
    assert child.exitcode == 0
    assert forked == [worlds.step(action)[0].tobytes() for action in actions]


@pytest.mark.parametrize(
    ("name", "threads", "message"),
    [
        ("stump_tracks", 0, "threads = 0: expected a whole number of at least 1"),
        ("stump_tracks", 1.5, "threads = 1.5: expected a whole number"),
        ("stump_tracks", 3, "threads = 3: expected at most 2, one for each world"),
        (
            "swing_up:SwingUp",
            2,
            "threads = 2: expected at most 1, these worlds do not have the benchmark's engine",
        ),
    ],
)
def test_impossible_numbers_of_threads_are_refused(name: str, threads: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_vector_environment(name, 2, threads=threads)


def test_an_environment_of_somebody_else_is_stepped_one_by_one() -> None:
    assert type(lock_step([gymnasium.make("Pendulum-v1") for _ in range(2)])) is LockStep
    assert type(lock_step([make_environment("parkour") for _ in range(2)])) is EngineLockStep


@pytest.mark.parametrize("name", IDS)
def test_who_handed_its_engine_over_is_reset_before_its_next_step(name: str) -> None:
    environment = make_environment(name)
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.release_engine()
    environment.reset(seed=0)
    environment.release_engine()
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(np.zeros(4))
    environment.reset(seed=0)
    environment.step(np.zeros(4))
