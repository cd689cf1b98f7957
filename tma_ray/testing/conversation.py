"""The exchange of simulated students with a teacher: an episode, then its queries until none is left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Answer, Episode, Query, QueryKind, Trajectory
from tma_ray.teachers import Teacher

StateValues = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""Returns values (n,) of observations (n, o)."""


def report_episode(teacher: Teacher, episode: Episode, state_values: StateValues) -> None:
    """Tells `teacher` of `episode` and answers what it asks.

    Raises:
        ValueError: it asks for a trajectory without having declared that it wants any.
    """
    query = teacher.observe(episode)
    while query is not None:
        query = teacher.answer(_answer(teacher, query, episode, state_values))


def _answer(teacher: Teacher, query: Query, episode: Episode, state_values: StateValues) -> Answer:
    if query.kind is QueryKind.STATE_VALUES:
        assert query.observations is not None, "a query for values holds observations"
        return state_values(query.observations)
    if not teacher.wants_trajectory:
        raise ValueError(
            f"{type(teacher).__name__} asked for a trajectory that was not recorded: declare "
            f"wants_trajectory = True in its class"
        )
    return even_trajectory(episode)


def even_trajectory(episode: Episode) -> Trajectory:
    """Returns the steps of a simulated episode: nothing changes, and rewards come evenly."""
    observations = np.tile(episode.initial_observation, (episode.length + 1, 1))
    rewards = np.full(episode.length, episode.episodic_return / episode.length)
    return Trajectory(observations, np.zeros((episode.length, 1), np.float32), rewards, terminated=False)
