"""Evaluations that a teacher asks for, played in a copy of the environment."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tma_ray.curriculum.episodes import Apply, Array, Environment, by_name, reset_to
from tma_ray.tasks import Outcomes, Task, TaskSpace


class TaskEvaluation:
    """Plays an episode of each task in a copy of the environment, for the argument `evaluate`.

    Args:
        make: function that returns a copy of the training loop's environment.
        act: function that returns actions (n, a) for observations (n, o).
        space: space of the tasks.
        mastery_return: episodic return over which a task is mastered.
        apply: function that prepares the environment for a task; see `Curriculum.wrap`.
        seed: seed of the first episode.
    """

    def __init__(
        self,
        make: Callable[[], Environment],
        act: Callable[[Array], Array],
        space: TaskSpace,
        mastery_return: float,
        *,
        apply: Apply | None = None,
        seed: int = 0,
    ) -> None:
        self._environment, self._act = make(), act
        self._space, self._mastery_return, self._apply = space, mastery_return, apply
        self._seed: int | None = seed

    def __call__(self, tasks: Task, greedy: bool) -> Outcomes:  # noqa: ARG002 - there is one policy
        """Return the outcomes of one episode of each of `tasks` (n, d)."""
        returns: NDArray[np.float64] = np.zeros(len(tasks))
        lengths = np.zeros(len(tasks), np.int64)
        for row, task in enumerate(tasks):
            named = by_name(self._space, task)
            observation, _ = reset_to(self._environment, named, self._apply, seed=self._seed)
            self._seed, over = None, False
            while not over:
                action = self._act(np.asarray(observation)[None])[0]
                observation, reward, terminated, truncated, _ = self._environment.step(action)
                returns[row] += float(reward)
                lengths[row] += 1
                over = terminated or truncated
        return Outcomes(returns, returns > self._mastery_return, lengths)
