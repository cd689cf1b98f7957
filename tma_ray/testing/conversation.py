"""The exchange of simulated students with a teacher: an episode, then its queries until none is left."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tma_ray.tasks import Answer, Episode, Outcomes, Query, QueryKind, Task, Trajectory
from tma_ray.teachers import Teacher

DISCOUNT = 0.99
"""Gamma of simulated students; rewards come evenly over an episode."""

StateValues = Callable[[NDArray[np.float32]], NDArray[np.float64]]
"""Returns values (n,) of observations (n, o)."""

Evaluate = Callable[[Task, bool], Outcomes]
"""Returns the outcomes of tasks (n, d); the second argument asks for the deterministic policy."""


def report_episode(teacher: Teacher, episode: Episode, state_values: StateValues, evaluate: Evaluate) -> None:
    """Tells `teacher` of `episode` and answers what it asks.

    Raises:
        ValueError: it asks for a trajectory or an evaluation without having declared that it wants any.
    """
    query = teacher.observe(episode)
    while query is not None:
        query = teacher.answer(_answer(teacher, query, episode, (state_values, evaluate)))


def _answer(teacher: Teacher, query: Query, episode: Episode, pupil: tuple[StateValues, Evaluate]) -> Answer:
    state_values, evaluate = pupil
    if query.kind is QueryKind.STATE_VALUES:
        assert query.observations is not None, "a query for values holds observations"
        return state_values(query.observations)
    wanted = "wants_trajectory" if query.kind is QueryKind.TRAJECTORY else "wants_evaluations"
    if not getattr(teacher, wanted):
        raise ValueError(
            f"{type(teacher).__name__} made a query of the kind {query.kind.value!r}: declare "
            f"{wanted} = True in its class"
        )
    if query.kind is QueryKind.TRAJECTORY:
        return even_trajectory(episode)
    assert query.tasks is not None, "a query for an evaluation holds tasks"
    return evaluate(query.tasks, query.greedy)


def even_trajectory(episode: Episode) -> Trajectory:
    """Returns the steps of a simulated episode: nothing changes, and rewards come evenly."""
    observations = np.tile(episode.initial_observation, (episode.length + 1, 1))
    rewards = np.full(episode.length, episode.episodic_return / episode.length)
    actions = np.zeros((episode.length, 1), np.float32)
    return Trajectory(observations, actions, rewards, terminated=False, gamma=DISCOUNT)
