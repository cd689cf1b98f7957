"""Our loop against stable-baselines3's own `learn`: same worlds, same noise, same networks after it."""

from itertools import islice

import numpy as np
import pytest
import stable_baselines3
import torch
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from students_support import Drift, differ, parameters, played, small_student, train
from torch import nn

from tma_ray.students import Transition
from tma_ray.students.base import StudentStreams
from tma_ray.students.hyperparameters import LogStd
from tma_ray.students.ppo import Trunk
from tma_ray.students.sac import POLICIES


def generators(seed: int) -> list[np.random.Generator]:
    """The student's exploration and mini-batch streams, once more."""
    return [np.random.default_rng(child) for child in StudentStreams.of(np.random.SeedSequence(seed))[1:3]]


def assert_same_networks(student, stock, atol: float = 1e-7) -> None:
    theirs = stock.policy.state_dict()
    for name, ours in parameters(student).items():
        np.testing.assert_allclose(ours, theirs[name].numpy(), rtol=1e-6, atol=atol, err_msg=name)


SHARED = {"net_arch": [], "activation_fn": nn.ReLU, "features_extractor_class": Trunk}
SHARED["features_extractor_kwargs"] = {"hidden_units": (16, 8)}
SEPARATE = {"net_arch": {"pi": [16, 8], "vf": [16, 8]}, "activation_fn": nn.Tanh}


def stock_ppo(student, policy_kwargs: dict[str, object]) -> stable_baselines3.PPO:
    """Return stable-baselines3's PPO on `Drift`, normalised, with the initial networks of `student`."""
    env = VecNormalize(DummyVecEnv([lambda: Drift(seed=1, limit=None)]))
    sizes = {"n_steps": 50, "batch_size": 25, "n_epochs": 2, "policy_kwargs": policy_kwargs}
    rates = {"learning_rate": 0.01, "clip_range": 0.02, "clip_range_vf": 0.05}
    stock = stable_baselines3.PPO("MlpPolicy", env, device="cpu", **sizes, **rates)
    stock.policy.load_state_dict(stock_parameters(student, policy_kwargs))
    return stock


def stock_parameters(student, policy_kwargs: dict[str, object]) -> dict[str, torch.Tensor]:
    """Return the parameters of `student` as `stock_ppo` has them; weights between trunks are 0."""
    own = {name: torch.from_numpy(value) for name, value in parameters(student).items()}
    if policy_kwargs is SHARED:
        return own
    found = {"log_std": own["log_std"]}
    for index, half in enumerate(("policy", "value")):
        last, inputs = {"policy": "action", "value": "value"}[half], slice(None)
        for place, units in ((0, 16), (2, 8)):
            kept = slice(units * index, units * index + units)
            weight = own[f"features_extractor.layers.{place}.weight"][kept]
            found[f"mlp_extractor.{half}_net.{place}.weight"] = weight[:, inputs]
            bias = own[f"features_extractor.layers.{place}.bias"]
            found[f"mlp_extractor.{half}_net.{place}.bias"] = bias[kept]
            assert weight.count_nonzero() == weight[:, inputs].count_nonzero()
            inputs = kept
        found[f"{last}_net.weight"] = own[f"{last}_net.weight"][:, inputs]
        found[f"{last}_net.bias"] = own[f"{last}_net.bias"]
        assert own[f"{last}_net.weight"].count_nonzero() == found[f"{last}_net.weight"].numel()
    return found


@pytest.mark.parametrize("name", ["ppo", "stock:ppo"])
@pytest.mark.parametrize(
    ("policy_kwargs", "values"),
    [(SHARED, {}), (SEPARATE, {"activation": "tanh", "separate_trunks": True})],
    ids=["shared", "separate"],
)
def test_ppo_learns_what_stable_baselines3_learns(name, policy_kwargs, values, monkeypatch):
    # so fast that both clips matter: of the ratio and of the value
    values |= {"learning_rate": 0.01, "clip_range": 0.02, "value_clip_range": 0.05}
    student = small_student(name, seed=3, **values)
    exploration, batches = generators(3)
    stock = stock_ppo(student, policy_kwargs)
    initial = parameters(student)
    gaussian = stock.policy.action_dist

    def sample() -> torch.Tensor:
        noise = torch.from_numpy(exploration.standard_normal((1, 2), dtype=np.float32))
        return torch.addcmul(gaussian.distribution.mean, gaussian.distribution.stddev, noise)

    monkeypatch.setattr(gaussian, "sample", sample)
    with monkeypatch.context() as patch:
        patch.setattr(np.random, "permutation", batches.permutation)
        stock.learn(200)
    train(student, Drift(seed=1, limit=None), 200)

    expected = stock.policy.state_dict()
    for key, ours in stock_parameters(student, policy_kwargs).items():
        np.testing.assert_allclose(ours, expected[key].numpy(), rtol=1e-6, atol=1e-7, err_msg=key)
    assert differ(initial, parameters(student))
    ones = np.ones(3, np.float32)
    np.testing.assert_allclose(student.normaliser.normalise(ones), stock.env.normalize_obs(ones), rtol=1e-6)


class ReplayedSAC(stable_baselines3.SAC):
    """Stock SAC that plays given actions, so that it meets the same transitions."""

    def _sample_action(self, learning_starts, action_noise=None, n_envs=1):
        action = next(self.actions)[None]
        return action, self.policy.scale_action(action)


@pytest.mark.parametrize("log_std", list(LogStd))
def test_sac_learns_what_stable_baselines3_learns(log_std, monkeypatch):
    student = small_student("sac", seed=3, buffer_size=1000, updates="interleaved", log_std=log_std.value)
    _, batches = generators(3)
    env = TimeLimit(Drift(seed=1, limit=None), 17)
    sizes = {"buffer_size": 1000, "learning_starts": 60, "batch_size": 20, "train_freq": 10}
    others = {"learning_rate": 1e-3, "ent_coef": 0.005, "policy_kwargs": {"net_arch": [16, 8]}}
    stock = ReplayedSAC(POLICIES[log_std], env, device="cpu", **sizes, **others)
    stock.set_parameters(student.model.get_parameters())
    stream = student._torch_stream.state[0].clone()
    transitions = train(student, TimeLimit(Drift(seed=1, limit=None), 17), 200)
    assert any(t.truncated for t in transitions)
    assert any(t.terminated for t in transitions)

    def sample(batch_size: int, env=None):
        ages = batches.integers(1, stock.replay_buffer.pos + 1, size=batch_size)
        return stock.replay_buffer._get_samples(stock.replay_buffer.pos - ages)

    monkeypatch.setattr(stock.replay_buffer, "sample", sample)
    stock.actions = iter([t.action for t in transitions])
    with torch.random.fork_rng():
        torch.set_rng_state(stream)
        stock.learn(200)
    assert stock._n_updates == student.model._n_updates == 14
    # its densities are of (action - mean) / deviation, which rounds where the deviation is about e^-9
    assert_same_networks(student, stock, atol=2e-5 if log_std is LogStd.TANH else 1e-7)


@pytest.mark.parametrize(("terminated", "truncated"), [(False, True), (True, False), (True, True)])
def test_only_a_time_limit_adds_the_value_of_what_it_cut_off(terminated, truncated):
    student = small_student("ppo")
    last = np.array([1, 2, 3], np.float32)
    action = student.act(np.zeros(3, np.float32))
    student.observe(Transition(np.zeros(3, np.float32), action, 0.25, last, terminated, truncated))
    seen = torch.from_numpy(student.normaliser.normalise(last)[None])
    value = student.model.policy.predict_values(seen).item()
    expected = student.normaliser.normalise_reward(0.25) + (0 if terminated else 0.99 * value)
    assert abs(value) > 0.01
    np.testing.assert_allclose(student.rollout.state()["rewards"], [expected], rtol=1e-6)


@pytest.mark.parametrize("name", ["sac", "stock:sac"])
@pytest.mark.parametrize("limit", [17, 30, 10])
def test_sac_updates_once_for_each_ten_steps_of_an_episode_at_its_end(name, limit):
    """From the first episode on, uniform actions or not, with fewer transitions than a batch; rounded up."""
    student, env = small_student(name, batch_size=60), Drift(limit=limit, ending=0.03)
    expected, lengths, start = 0, set(), 0
    for step, seen in enumerate(islice(played(student, env), 250), 1):
        if seen.terminated or seen.truncated:
            lengths.add(step - start)
            expected += -(-(step - start) // 10)
            start = step
        assert student.model._n_updates == expected, step
    assert len(lengths) > 3
    assert limit in lengths


def test_an_episode_across_a_reset_owes_updates_for_all_of_its_steps():
    student, env = small_student("sac"), Drift(limit=37, ending=0.0)
    train(student, env, 37 + 20)
    student.reset()
    assert student.model._n_updates == 0
    for seen in islice(played(student, env, env.state.astype(np.float32)), 17):  # the same episode goes on
        assert student.model._n_updates == (4 if seen.truncated else 0)
    assert seen.truncated
    assert len(student.replay) == 17


@pytest.mark.parametrize("name", ["ppo", "sac", "stock:ppo", "stock:sac"])
def test_the_precision_is_set_during_updates_only(name, monkeypatch):
    student, seen = small_student(name, matmul_precision="medium"), set()
    train_once = student._train

    def spy(*arguments) -> None:
        seen.add(torch.get_float32_matmul_precision())
        train_once(*arguments)

    monkeypatch.setattr(student, "_train", spy)
    train(student, Drift(), 100)
    assert seen == {"medium"}
    assert torch.get_float32_matmul_precision() == "highest"


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_a_lean_state_loads_into_stock_and_back(name, tmp_path):
    lean, stock = small_student(name, seed=3), small_student(f"stock:{name}", seed=4)
    train(lean, Drift(seed=1, limit=13, ending=0.0), 130)  # to the end of an episode
    lean.save(tmp_path)
    stock.load(tmp_path)
    for student in (lean, stock):
        student._episode_starts = True
        train(student, Drift(seed=2), 60)
    theirs = parameters(stock)
    for key, value in parameters(lean).items():
        np.testing.assert_allclose(value, theirs[key], atol=2e-5, err_msg=key)
