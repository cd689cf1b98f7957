"""One episode as a video or a picture, without a window."""

from __future__ import annotations

from argparse import ArgumentTypeError
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tma_ray.commands.quantities import COORDINATE
from tma_ray.part_names import nearest
from tma_ray.runs.saved_policies import StepPolicy
from tma_ray.tasks import Task, TaskSpace, check_task
from tma_ray.viewing.pictures import Frame, check_picture, write_frames
from tma_ray.viewing.rendered_environment import RenderedEnvironment, RenderSettings, open_rendered


@dataclass(frozen=True)
class EpisodeSettings(RenderSettings):
    """Settings of one rendered episode.

    Attributes:
        task: as `parse_task` takes it.
    """

    task: str | None = None


@dataclass
class RenderedEpisode:
    """Outcome of a rendered episode so far.

    Attributes:
        task: that was played (d,).
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


def render(settings: EpisodeSettings, output: Path) -> RenderedEpisode:
    """Plays an episode into the file `output`: .mp4 or .gif, or .png for its last frame.

    Raises:
        ValueError: a file that cannot be written, no such policy or one that does not fit, an environment
            that cannot be drawn, or a task outside its valid domain; all before anything is played.
    """
    check_picture(output)
    rendered = open_rendered(settings)
    try:
        tasks, actions = (np.random.default_rng([settings.seed, stream]) for stream in range(2))
        episode = RenderedEpisode(parse_task(settings.task, rendered.space, rendered.domain, tasks))
        every = 0 if output.suffix == ".png" else settings.every
        frames = _play(rendered, rendered.acting_policy(actions), settings, episode, every)
        write_frames(output, frames, rendered.frame_rate / settings.every)
    finally:
        rendered.close()
    return episode


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
            hint = nearest(name.strip(), space.names)
            raise ValueError(f"task {text!r}: no dimension {name!r}: {hint}known: {', '.join(space.names)}")
        try:
            values[name.strip()] = COORDINATE(value)
        except ArgumentTypeError:
            raise ValueError(f"task {text!r}: {name} = {value!r}: expected a number") from None
    return check_task(list(values.values()), domain)


def _play(
    rendered: RenderedEnvironment,
    policy: StepPolicy,
    settings: EpisodeSettings,
    episode: RenderedEpisode,
    every: int,
) -> Iterator[Frame]:
    """Yields a frame every `every` steps, the first and the last included; for 0 the last alone."""
    environment = rendered.environment
    observation, _ = environment.reset(seed=settings.seed, options={"task": episode.task})
    while episode.steps < settings.steps and not episode.ended:
        if every and episode.steps % every == 0:
            yield rendered.frame()
        observation, reward, terminated, truncated, info = environment.step(policy(observation))
        episode.steps += 1
        episode.episodic_return += float(reward)
        episode.ended = bool(terminated or truncated)
        episode.success = bool(info.get("success", False))
    yield rendered.frame()
