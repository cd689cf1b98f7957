"""Rollout workers and a learner against students that learn alone."""

import copy
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from students_support import SMALL, Drift, actions_of, small_student, train, train_episodes
from suite.processes import python

from tma_ray.students import Learner, make_rollout_worker
from tma_ray.students.cohort.server import LearnerServer
from tma_ray.students.ppo import PPO
from tma_ray.students.rollout_workers import CohortSettings, LearnerError, LearnerLostError, ask_learner, link
from tma_ray.students.rollout_workers.base import RolloutWorker
from tma_ray.students.rollout_workers.link import SharedBuffer, buffer_size


@contextmanager
def serving(folder: Path, width: int = 3) -> Iterator[tuple[Learner, LearnerServer]]:
    """Serve rollout workers in a thread of this process."""
    folder.mkdir(exist_ok=True)
    learner, over = Learner(str(folder / "learner"), b"secret"), threading.Event()
    server = LearnerServer(learner, CohortSettings(width=width))
    thread = threading.Thread(target=server.serve, args=(over.is_set, 0.02))
    thread.start()
    try:
        yield learner, server
    finally:
        over.set()
        thread.join()


@pytest.fixture
def learner(tmp_path: Path) -> Iterator[Learner]:
    with serving(tmp_path) as (learner, _):
        yield learner


def worker_of(learner: Learner, name: str, seed: int = 0, **hyperparameters) -> RolloutWorker:
    env, values = Drift(), {**SMALL[name], **hyperparameters}
    spaces = env.observation_space, env.action_space
    return make_rollout_worker(name, *spaces, np.random.SeedSequence(seed), values, learner)


def weights(student, folder: Path) -> dict[str, np.ndarray]:
    """The greedy policy's tensors."""
    from safetensors.numpy import load_file

    folder.mkdir()
    student.save_policy(folder)
    (file,) = folder.glob("*.safetensors")
    return load_file(file)


STATES = np.random.default_rng(0).normal(size=(6, 3)).astype(np.float32)
VARIANTS = {"activation": "tanh", "separate_trunks": True}, {"averaged_steps": 100}


@pytest.mark.parametrize("hyper", [{}, *VARIANTS], ids=["default", "separate trunks", "average"])
def test_ppo_learns_as_alone(learner, tmp_path, hyper):
    """Same worlds, same noise, same mini-batches: equal to rounding after several rollouts."""
    alone, worker = small_student("ppo", **hyper), worker_of(learner, "ppo", **hyper)
    acted = [actions_of(train(student, Drift(seed=5), 260)) for student in (alone, worker)]
    np.testing.assert_allclose(*acted, rtol=1e-3, atol=1e-4)
    expected, learned = weights(alone, tmp_path / "alone"), weights(worker, tmp_path / "worker")
    for name, values in expected.items():
        np.testing.assert_allclose(learned[name], values, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(worker.state_values(STATES), alone.state_values(STATES), rtol=1e-3)
    np.testing.assert_allclose(worker.act_greedily(STATES), alone.act_greedily(STATES), rtol=1e-3, atol=1e-5)


def test_sac_hands_over_what_it_sees(tmp_path):
    """While actions are uniform, replay and number of updates are those of the student that learns alone."""
    values = {"exploration_steps": 10_000, "buffer_size": 100}
    alone = small_student("sac", **values)
    train_episodes(alone, range(16))
    with serving(tmp_path) as (learner, server):
        worker = worker_of(learner, "sac", **values)
        train_episodes(worker, range(16))
        (run,) = server._slots.values()
        kept, stacked = list(run.student.replay.pieces()), list(run.stack._replay.pieces(run.slot))
        updates = run.stack.networks(run.slot).number
    for one, other in zip(alone.replay.pieces(), kept, strict=True):
        for left, right in zip(one, other, strict=True):
            np.testing.assert_array_equal(left, right)
    for column in (1, 2):  # actions and rewards
        own, theirs = (np.concatenate([piece[column] for piece in pieces]) for pieces in (stacked, kept))
        np.testing.assert_array_equal(own, theirs)
    assert updates == alone.model._n_updates


@pytest.mark.parametrize(("name", "values"), [("ppo", {}), ("sac", {}), ("sac", {"log_std": "clamp"})])
def test_actions_without_learning_are_those_of_act(learner, name, values):
    """With the same noise the same action, alone and in a cohort; several at once are close to one by one."""
    alone, worker = (make(name, **values) for make in (small_student, partial(worker_of, learner)))
    for student in (alone, worker):
        train(student, Drift(seed=5, limit=10, ending=0.0), 130)
        sampled = student.sample_actions(STATES[:1], copy.deepcopy(student._exploration))
        together = student.sample_actions(STATES, np.random.default_rng(3))
        one_by_one = np.random.default_rng(3)
        singles = np.concatenate([student.sample_actions(state[None], one_by_one) for state in STATES])
        np.testing.assert_allclose(together, singles, rtol=1e-4, atol=1e-5)
        student._episode_starts = False  # else acting counts the observation first
        np.testing.assert_allclose(sampled[0], student.act(STATES[0]), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("name", "hyper"), [("sac", {}), *(("ppo", hyper) for hyper in ({}, *VARIANTS))])
def test_a_run_moves_out_of_a_cohort_and_into_one(learner, tmp_path, name, hyper):
    """The files are those of the student that learns alone, each loads what the other saved, and goes on."""
    worker = worker_of(learner, name, seed=3, **hyper)
    env = Drift(seed=9, limit=10, ending=0.0)
    train(worker, env, 130)
    worker.save(tmp_path)
    alone = small_student(name, seed=3, **hyper)
    alone.load(tmp_path)
    np.testing.assert_allclose(alone.act_greedily(STATES), worker.act_greedily(STATES), rtol=1e-5, atol=1e-6)
    second = tmp_path / "second"
    second.mkdir()
    alone.save(second)
    again = worker_of(learner, name, seed=3, **hyper)
    again.load(second)
    np.testing.assert_array_equal(again.act_greedily(STATES), worker.act_greedily(STATES))
    ends = [actions_of(train(each, Drift(seed=1, limit=10, ending=0.0), 120)) for each in (worker, again)]
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_neighbours_change_no_bit(tmp_path, name):
    """A run is the same alone in its cohort, beside others, and after one of them has left."""
    played = []
    for neighbours in (0, 2):
        with serving(tmp_path / str(neighbours)) as (learner, _):
            others = [worker_of(learner, name, seed=10 + k) for k in range(neighbours)]
            for other in others:
                train(other, Drift(seed=2), 60)
            if others:
                others[0]._link.close()
            worker = worker_of(learner, name)
            played.append(actions_of(train(worker, Drift(seed=5), 160)))
            for other in others[1:]:
                train(other, Drift(seed=3), 60)
    np.testing.assert_array_equal(*played)


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_a_reset_gives_the_networks_of_the_student_alone(learner, tmp_path, name):
    alone, worker = small_student(name), worker_of(learner, name)
    for student in (alone, worker):
        train(student, Drift(seed=5), 40)
        student.reset()
    expected, learned = weights(alone, tmp_path / "alone"), weights(worker, tmp_path / "worker")
    if name == "ppo":  # of SAC the generator that initialises has also drawn the noise of updates alone
        for key, values in expected.items():
            np.testing.assert_allclose(learned[key], values, rtol=1e-6)
    train(worker, Drift(seed=6), 120)


def test_a_full_cohort_refuses(tmp_path):
    with serving(tmp_path, width=1) as (learner, _):
        first = worker_of(learner, "ppo")
        with pytest.raises(LearnerError, match="all 1 slots"):
            worker_of(learner, "ppo", seed=1)
        train(first, Drift(), 60)


def test_without_a_learner(tmp_path):
    with pytest.raises(LearnerLostError, match="no learner listens"):
        worker_of(Learner(str(tmp_path / "nobody"), b""), "ppo")


def test_students_without_a_stacked_learner_are_refused(learner):
    spaces = Drift().observation_space, Drift().action_space
    with pytest.raises(ValueError, match="'TQC' cannot learn in a cohort: ppo, sac can"):
        make_rollout_worker("TQC", *spaces, np.random.SeedSequence(0), {}, learner)


def test_the_hardware_of_a_cohort_is_known(learner):
    expected = {"device": "cpu", "cohort": 3, "compiled": False, "threads": 1}
    capability = torch.backends.cpu.get_cpu_capability()
    assert ask_learner(learner, "hardware") == expected | {"vector_extensions": capability}


def test_the_fingerprint_of_a_player_needs_no_torch():
    code = (
        "import json, sys; from tma_ray.runs.placement import fingerprint\n"
        "found = json.loads(fingerprint(1, 'cpu', {'vector_extensions': 'AVX2'}))\n"
        "print(found['vector_extensions'], 'torch' in found, 'torch' in sys.modules)"
    )
    assert python("-c", code).split() == ["AVX2", "True", "False"]


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_shared_memory_changes_no_bit(tmp_path, monkeypatch, name):
    """The same weights where the system has no memory without a name, and all goes through the socket."""
    played = []
    for shared in (True, False):
        with monkeypatch.context() as patch, serving(tmp_path / str(shared)) as (learner, server):
            patch.setattr(link, "has_shared_memory", lambda shared=shared: shared)
            worker = worker_of(learner, name)
            played.append(actions_of(train(worker, Drift(seed=5), 160)))
            assert len(server._buffers) == shared
    np.testing.assert_array_equal(*played)


def test_a_buffer_returns_what_was_posted_and_larger_ones_replace_it():
    parts = np.arange(5, dtype=np.float32), True, np.zeros((0, 3)), np.arange(6).reshape(2, 3)
    box = SharedBuffer.create(buffer_size(parts))
    found = box.collect(box.post(parts))
    for one, other in zip(parts, found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert found[0].flags.owndata, "the next message may not change it"
    with pytest.raises(ValueError, match="cannot reshape"):
        box.post([np.zeros(1_000)])
    box.close()


def test_an_empty_stack_makes_room_for_one_of_another_kind(tmp_path):
    """A rollout worker that leaves keeps its kind's memory for the next, until another kind needs some."""
    with serving(tmp_path) as (learner, server):
        first = worker_of(learner, "ppo")
        first._link.close()
        again = worker_of(learner, "ppo", seed=1)
        (stack,) = server._pool.stacks
        other = worker_of(learner, "sac")
        assert stack in server._pool.stacks
        again._link.close()
        train(other, Drift(), 60)
        third = worker_of(learner, "ppo", epochs=1)
        assert stack not in server._pool.stacks
        assert len(server._pool.stacks) == 2
        train(third, Drift(), 60)


def test_a_checkpoint_holds_no_other_run_up(learner, tmp_path, monkeypatch):
    """While one rollout worker waits for its files, another learns."""
    first, second = worker_of(learner, "ppo"), worker_of(learner, "ppo", seed=1)
    begun, let = threading.Event(), threading.Event()
    write = PPO.save

    def slow(*arguments):
        begun.set()
        assert let.wait(60)
        return write(*arguments)

    monkeypatch.setattr(PPO, "save", slow)
    saving = threading.Thread(target=first.save, args=(tmp_path,))
    saving.start()
    assert begun.wait(60)
    train(second, Drift(), 130)
    assert saving.is_alive()
    let.set()
    saving.join()
    again = worker_of(learner, "ppo", seed=1)
    again.load(tmp_path)
