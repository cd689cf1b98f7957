"""One teacher for actors of Ray."""

from __future__ import annotations

import gymnasium
import numpy as np
import ray

from tma_ray.curriculum import Curriculum, SharedCurriculum


def set_mass(environment: gymnasium.Env, task: dict[str, float]) -> None:
    environment.unwrapped.m = task["mass"]


class Worker:
    """An actor with an environment of its own."""

    def __init__(self, handle: SharedCurriculum) -> None:
        self.environment = handle.wrap(gymnasium.make("Pendulum-v1", max_episode_steps=5), set_mass)

    def play(self, episodes: int) -> list[float]:
        """Return the masses of so many episodes, and begin another one."""
        masses = [float(self.environment.reset(seed=0)[1]["task"][0])]
        for _ in range(episodes):
            while not self.environment.step(np.zeros(1, np.float32))[3]:
                pass
            masses.append(float(self.environment.reset()[1]["task"][0]))
        return masses[:-1]


def test_actors_share_a_teacher_and_one_that_dies_costs_its_episode_only(cluster: None) -> None:
    curriculum = Curriculum("riac", {"mass": (0.5, 2.0)}, mastery_return=-50)
    handle = curriculum.shared(host="127.0.0.1")
    first, second = (ray.remote(num_cpus=0)(Worker).remote(handle) for _ in range(2))
    played = ray.get([first.play.remote(3), second.play.remote(3)])
    ray.kill(first)
    played.append(ray.get(second.play.remote(2)))
    assert sorted(np.concatenate(played)) == sorted(curriculum.episodes["task_mass"])
    assert curriculum.episodes["length"].tolist() == [5] * 8
