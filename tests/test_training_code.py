"""Training code of others on our worlds: the adapter for stable-baselines3, the page's block for Tianshou."""

from functools import partial
from importlib.util import find_spec
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import sb3_pendulum
import sb3_withheld
import torch
from gymnasium import wrappers
from sb3_worlds import SB3Worlds
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

import tma_ray  # noqa: F401  (registers the environments)
from tma_ray.curriculum import Curriculum, SharedCurriculum
from tma_ray.envs import make_environment

COUNT = 3


class OnTasks(gymnasium.Wrapper):
    """A world whose episodes are on given tasks, in order."""

    def __init__(self, tasks: list[np.ndarray]) -> None:
        super().__init__(make_environment("stump_tracks"))
        self.tasks = iter(tasks)

    def reset(self, *, seed=None, options=None):
        return self.env.reset(seed=seed, options={"task": next(self.tasks)})


def same_infos(given, expected) -> bool:
    """Tell whether infos of several worlds hold the same, whatever their types of truth."""
    pairs = zip(given, expected, strict=True)
    return all(
        one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)
        for one, other in pairs
    )


@pytest.mark.filterwarnings("error")
def test_the_adapter_gives_what_stable_baselines3s_own_gives() -> None:
    """Also the last observation of an episode, and whether it was truncated."""
    tasks = [np.array([0.0, 6.0])] * 1_000
    worlds = SB3Worlds(
        gymnasium.make_vec(
            "tma_ray/StumpTracks-v0", num_envs=COUNT, autoreset_mode="SameStep", next_task=lambda: tasks[0]
        )
    )
    expected = DummyVecEnv([lambda: OnTasks(tasks)] * COUNT)
    for environment in (worlds, expected):
        environment.seed(3)
    assert worlds.reset().tobytes() == expected.reset().tobytes()
    assert same_infos(worlds.reset_infos, expected.reset_infos)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(400):
        actions = rng.uniform(-1, 1, (COUNT, 4)).astype(np.float32)
        for environment in (worlds, expected):
            environment.step_async(actions)
        observations, rewards, over, infos = worlds.step_wait()
        wanted = expected.step_wait()
        assert observations.tobytes() == wanted[0].tobytes()
        np.testing.assert_allclose(rewards, wanted[1], rtol=1e-6)  # stable-baselines3 keeps them in float32
        assert over.tolist() == wanted[2].tolist()
        ends += int(over.sum())
        assert same_infos([infos[row] for row in np.flatnonzero(over)], np.array(wanted[3])[over])
        assert all(info.keys() == {"success", "task"} for info in np.array(infos)[~over])
    assert ends > COUNT
    assert worlds.get_attr("render_mode", [0, 2]) == [None, None]
    worlds.set_attr("max_episode_steps", 7, indices=1)
    assert worlds.get_attr("max_episode_steps") == [2000, 7, 2000]


def test_ppo_of_stable_baselines3_trains_on_it() -> None:
    worlds = gymnasium.make_vec("tma_ray/Parkour-v0", 2, embodiment="fish", autoreset_mode="SameStep")
    environment = SB3Worlds(worlds)
    model = PPO("MlpPolicy", environment, n_steps=16, batch_size=16, n_epochs=1, device="cpu").learn(64)
    assert model.num_timesteps == 64


def test_a_teacher_chooses_the_tasks_of_stable_baselines3(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert 0 <= sb3_pendulum.train("alp_gmm:fit_every=5", steps=2_048, test_tasks=2) <= 1
    assert len(Curriculum.load("pendulum/alp_gmm-0").episodes) == 8  # two of each of four environments


@pytest.mark.parametrize("name", ["sb3_pendulum", "sb3_hopper"])
def test_an_example_with_a_teacher_is_short(name: str) -> None:
    assert len((Path(sb3_pendulum.__file__).parent / f"{name}.py").read_text().splitlines()) < 40


if find_spec("mujoco"):  # 60 MB for one example, so that it is no requirement of the project

    @pytest.mark.slow
    def test_a_teacher_chooses_mass_and_friction_of_the_hopper(tmp_path: Path, monkeypatch) -> None:
        import sb3_hopper

        monkeypatch.chdir(tmp_path)
        assert 0 <= sb3_hopper.train("alp_gmm:fit_every=5", steps=2_048, test_tasks=2) <= 1
        environment = gymnasium.make("Hopper-v5")
        sb3_hopper.set_task(environment, {"mass": 2.0, "friction": 0.5})
        model, usual = environment.unwrapped.model, sb3_hopper.USUAL
        np.testing.assert_allclose(model.body_mass, 2 * usual.body_mass)
        np.testing.assert_allclose(model.geom_friction[:, 0], usual.geom_friction[:, 0] / 2)
        assert len(Curriculum.load("hopper/alp_gmm-0").episodes) > 20


def test_steps_that_must_not_train_stay_out_of_the_updates_of_stable_baselines3(monkeypatch) -> None:
    learned, get = [], sb3_withheld.TrainingSteps.get

    def counted(buffer: sb3_withheld.TrainingSteps, batch_size: int | None = None):
        for batch in get(buffer, batch_size):
            learned.append(len(batch.observations))
            yield batch

    short = partial(gymnasium.make, max_episode_steps=20)
    monkeypatch.setattr(sb3_withheld.gymnasium, "make", short)
    monkeypatch.setattr(sb3_withheld.TrainingSteps, "get", counted)
    settings = {"n_steps": 100, "batch_size": 32, "n_epochs": 1}
    frame = sb3_withheld.main("robust_plr:buffer_size=6", steps=2_000, **settings).episodes
    assert len(frame) == 100
    assert 0 < sum(learned) == frame.loc[frame["trains"], "length"].sum() < 2_000


def make_world(handle: SharedCurriculum) -> gymnasium.Env:
    return handle.wrap(gymnasium.make("tma_ray:tma_ray/StumpTracks-v0", max_episode_steps=100))


@pytest.mark.slow  # the fast tests share a teacher among processes without torch
def test_the_processes_of_stable_baselines3_share_a_teacher() -> None:
    curriculum = Curriculum("random", make_environment("stump_tracks"), mastery_return=230)
    worlds = SubprocVecEnv([partial(make_world, curriculum.shared())] * 2, start_method="spawn")
    PPO("MlpPolicy", worlds, n_steps=256, n_epochs=1, seed=0, device="cpu").learn(512)
    worlds.close()
    assert len(curriculum.episodes) >= 4  # two of each


@pytest.mark.filterwarnings("error")
def test_the_check_of_stable_baselines3_accepts_an_environment_with_a_teacher() -> None:
    curriculum = Curriculum("random", make_environment("stump_tracks"), mastery_return=230)
    check_env(curriculum.wrap(gymnasium.make("tma_ray/StumpTracks-v0")))


def test_a_teacher_in_a_ppo_of_one_file() -> None:
    """As of CleanRL: environments are wrapped where they are made, below those that normalise."""
    curriculum = Curriculum("alp_gmm:fit_every=5", make_environment("stump_tracks"), mastery_return=230)

    def make_env() -> gymnasium.Env:
        env = curriculum.wrap(gymnasium.make("tma_ray/StumpTracks-v0", max_episode_steps=15))
        env = wrappers.ClipAction(wrappers.RecordEpisodeStatistics(wrappers.FlattenObservation(env)))
        return wrappers.NormalizeReward(wrappers.NormalizeObservation(env), gamma=0.99)

    torch.manual_seed(0)
    envs = gymnasium.vector.SyncVectorEnv([make_env] * COUNT)
    actor, critic = (torch.nn.Sequential(torch.nn.Linear(24, 8), torch.nn.Linear(8, size)) for size in (4, 1))
    optimizer, returns = torch.optim.Adam([*actor.parameters(), *critic.parameters()]), []
    observations, _ = envs.reset(seed=0)
    for _ in range(2):
        seen, actions, rewards, overs = [], [], [], []
        for _ in range(32):
            seen.append(torch.as_tensor(observations, dtype=torch.float32))
            actions.append(torch.distributions.Normal(actor(seen[-1]).detach(), 1.0).sample())
            observations, reward, terminated, truncated, info = envs.step(actions[-1].numpy())
            rewards.append(torch.as_tensor(reward, dtype=torch.float32))
            overs.append(torch.as_tensor(terminated | truncated))
            returns += info["episode"]["r"][info["_episode"]].tolist() if "episode" in info else []
        states, target, targets = torch.stack(seen), torch.zeros(COUNT), []
        for reward, over in zip(reversed(rewards), reversed(overs), strict=True):
            target = reward + 0.99 * target * ~over
            targets.insert(0, target)
        advantages = torch.stack(targets) - critic(states)[..., 0]
        log_probs = torch.distributions.Normal(actor(states), 1.0).log_prob(torch.stack(actions)).sum(-1)
        ratio = (log_probs - log_probs.detach()).exp()
        clipped = torch.min(ratio * advantages.detach(), ratio.clip(0.8, 1.2) * advantages.detach())
        optimizer.zero_grad()
        (advantages.square() - clipped).mean().backward()
        optimizer.step()
    assert len(returns) >= 3 * COUNT
    np.testing.assert_allclose(curriculum.episodes["episodic_return"], returns, rtol=1e-4, atol=1e-4)


if find_spec("tianshou"):  # no requirement of the project, so that without it there is nothing to skip

    @pytest.mark.slow
    def test_tianshou_collects_from_them() -> None:
        text = (Path(__file__).parents[1] / "docs" / "training_code.md").read_text()
        block = text.partition("## Tianshou")[2].partition("```python\n")[2].partition("```")[0]
        seen: dict[str, object] = {}
        exec(compile(block, "training_code.md", "exec"), seen)
        assert np.shape(seen["observations"]) == (4, 24)


def taught_worlds(**options: object) -> gymnasium.vector.VectorEnv:
    """Return worlds with a teacher that counts their episodes."""
    worlds = gymnasium.make_vec("tma_ray:tma_ray/StumpTracks-v0", num_envs=2, max_episode_steps=10, **options)
    return Curriculum("random", make_environment("stump_tracks"), mastery_return=230).wrap_vector(worlds)


if find_spec("skrl"):

    @pytest.mark.slow
    def test_skrl_steps_worlds_with_a_teacher() -> None:
        from skrl.envs.wrappers.torch import wrap_env

        default = wrap_env(gymnasium.make_vec("tma_ray:tma_ray/StumpTracks-v0", num_envs=2), verbose=False)
        default.reset()
        for _ in range(300):  # beyond the ends of episodes
            *_, terminated, truncated, _ = default.step(torch.ones(2, 4))
        assert (default.num_envs, terminated.shape, truncated.shape) == (2, (2, 1), (2, 1))
        worlds = taught_worlds()
        wrapped = wrap_env(worlds, verbose=False)
        wrapped.reset()
        for _ in range(25):
            observations, *_ = wrapped.step(torch.zeros(2, 4))
        assert observations.shape == (2, 24)
        assert len(worlds._link.episodes) == 4


if find_spec("torchrl"):

    @pytest.mark.slow
    def test_torchrl_rolls_out_worlds_and_a_teachers_environment() -> None:
        from torchrl.envs import GymWrapper, check_env_specs

        worlds = GymWrapper(
            gymnasium.make_vec(
                "tma_ray:tma_ray/StumpTracks-v0", num_envs=2, max_episode_steps=10, autoreset_mode="SameStep"
            )
        )
        check_env_specs(worlds)
        assert int(worlds.rollout(25, break_when_any_done=False)["next", "done"].sum()) == 4
        curriculum = Curriculum("random", make_environment("stump_tracks"), mastery_return=230)
        taught = GymWrapper(curriculum.wrap(gymnasium.make("tma_ray/StumpTracks-v0", max_episode_steps=10)))
        taught.rollout(25, break_when_any_done=False)
        assert len(curriculum.episodes) == 2


if find_spec("tianshou"):

    @pytest.mark.slow
    def test_tianshou_steps_a_teachers_environments() -> None:
        from tianshou.env import DummyVectorEnv

        curriculum = Curriculum("random", make_environment("stump_tracks"), mastery_return=230)
        worlds = DummyVectorEnv(
            [lambda: curriculum.wrap(gymnasium.make("tma_ray/StumpTracks-v0", max_episode_steps=10))] * 2
        )
        worlds.reset()
        for _ in range(10):
            *_, truncated, _ = worlds.step(np.zeros((2, 4), np.float32))
        assert truncated.all()
        assert len(curriculum.episodes) == 2


def rllib_ppo(world: str, **runners: object):
    from ray.rllib.algorithms.ppo import PPOConfig

    config = PPOConfig().environment(world).env_runners(num_envs_per_env_runner=2, **runners)
    return config.training(train_batch_size_per_learner=100, minibatch_size=50, num_epochs=1).build_algo()


if find_spec("tree"):  # of RLlib's requirements, the one that nothing else has

    @pytest.mark.slow
    def test_rllib_trains_in_our_vector_environments() -> None:
        entry = {"num_env_runners": 0, "gym_env_vectorize_mode": "vector_entry_point"}
        algorithm = rllib_ppo("tma_ray:tma_ray/StumpTracks-v0", **entry)
        assert algorithm.train()["num_env_steps_sampled_lifetime"] >= 100
        algorithm.stop()

    @pytest.mark.slow
    def test_the_runners_of_rllib_share_a_teacher() -> None:
        import ray
        from ray.tune.registry import register_env

        curriculum = Curriculum("random", make_environment("stump_tracks"), mastery_return=230)
        handle = curriculum.shared()
        world = {"id": "tma_ray:tma_ray/StumpTracks-v0", "max_episode_steps": 20}
        register_env("taught", lambda config: handle.wrap(gymnasium.make(**world)))
        algorithm = rllib_ppo("taught", num_env_runners=1)
        algorithm.train()
        algorithm.stop()
        ray.shutdown()
        assert curriculum.episodes["length"].tolist() == [20] * 4  # two of each of two environments
