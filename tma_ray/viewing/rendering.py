"""One episode as a video or a picture, without a window."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tma_ray.runs.saved_policies import Player
from tma_ray.tasks import Task, TaskSpace, check_task
from tma_ray.viewing.pictures import Frame, check_picture, write_frames
from tma_ray.viewing.stage import Performance, Stage, open_stage


@dataclass(frozen=True)
class Scenario(Performance):
    """What to render: one episode.

    Attributes:
        task: as `parse_task` takes it.
    """

    task: str | None = None


@dataclass
class Outcome:
    """What has happened in the episode so far.

    Attributes:
        task: that it was played on (d,).
        steps: how many were taken.
        episodic_return: sum of rewards.
        ended: whether the episode is over.
        success: what the environment said last.
    """

    task: Task
    steps: int = 0
    episodic_return: float = 0.0
    ended: bool = False
    success: bool = False


def render(scenario: Scenario, output: Path) -> Outcome:
    """Plays an episode into the file `output`: .mp4 or .gif, or .png for its last frame.

    Raises:
        ValueError: a file that cannot be written, no such policy or one that does not fit, an environment
            that cannot be drawn, or a task outside its valid domain; all before anything is played.
    """
    check_picture(output)
    stage = open_stage(scenario)
    try:
        tasks, actions = (np.random.default_rng([scenario.seed, stream]) for stream in range(2))
        outcome = Outcome(parse_task(scenario.task, stage.space, stage.domain, tasks))
        every = 0 if output.suffix == ".png" else scenario.every
        frames = _play(stage, stage.player(actions), scenario, outcome, every)
        write_frames(output, frames, stage.frame_rate / scenario.every)
    finally:
        stage.close()
    return outcome


def parse_task(text: str | None, space: TaskSpace, domain: TaskSpace, rng: np.random.Generator) -> Task:
    """Returns the task that `text` names (d,).

    Args:
        text: "3,0.5", or "stump_height=3" with the other dimensions in the middle of `space`; None for the
            middle, "random" for a task drawn from `space`.
        space: tasks that a teacher may choose.
        domain: tasks that the environment can build.
        rng: draws a random task.

    Raises:
        ValueError: no numbers, too few or too many, an unknown dimension, or a task outside `domain`.
    """
    if text == "random":
        return space.sample(rng)
    values = dict(zip(space.names, space.centre, strict=True))
    given = [value.strip() for value in text.split(",")] if text else []
    if any("=" in value for value in given):
        pairs = [value.partition("=")[::2] for value in given]
    elif given and len(given) != space.size:
        raise ValueError(f"task {text!r}: expected {space.size} numbers ({', '.join(space.names)})")
    else:
        pairs = list(zip(space.names, given, strict=False))
    for name, value in pairs:
        if name.strip() not in values:
            raise ValueError(f"task {text!r}: no dimension {name!r}; there are {', '.join(space.names)}")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            raise ValueError(f"task {text!r}: {name} = {value!r}: expected a number") from None
    return check_task(list(values.values()), domain)


def _play(stage: Stage, player: Player, scenario: Scenario, outcome: Outcome, every: int) -> Iterator[Frame]:
    """Yields a frame every `every` steps, the first and the last included; for 0 the last alone."""
    environment = stage.environment
    observation, _ = environment.reset(seed=scenario.seed, options={"task": outcome.task})
    while outcome.steps < scenario.steps and not outcome.ended:
        if every and outcome.steps % every == 0:
            yield stage.frame()
        observation, reward, terminated, truncated, info = environment.step(player(observation))
        outcome.steps += 1
        outcome.episodic_return += float(reward)
        outcome.ended = bool(terminated or truncated)
        outcome.success = bool(info.get("success", False))
    yield stage.frame()
