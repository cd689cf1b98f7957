"""Plays a policy in a window, or into a video without one."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tma_ray.tasks import Task
from tma_ray.viewing.pictures import Frame, check_picture, write_frames
from tma_ray.viewing.play.board import Board
from tma_ray.viewing.play.session import Session
from tma_ray.viewing.play.window import SMALLEST, Window, check_display
from tma_ray.viewing.rendering import parse_task
from tma_ray.viewing.stage import Performance, Stage, open_stage


@dataclass(frozen=True)
class Played(Performance):
    """What to play: episode k has the seed plus k; `steps` and `every` are of a video.

    Attributes:
        tasks: each as `parse_task` takes it; played one after the other. None is the middle of the space.
        size: width and height of window or video, in pixels; None for one that shows all of the world.
    """

    tasks: tuple[str | None, ...] = (None,)
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size is not None and (self.size[0] < SMALLEST[0] or self.size[1] < SMALLEST[1]):
            smallest = "x".join(map(str, SMALLEST))
            raise ValueError(f"size {self.size[0]}x{self.size[1]}: expected at least {smallest} pixels")


@dataclass
class PlayedEpisode:
    """How an episode of a video went.

    Attributes:
        task: that it was played on (d,).
        steps: how many were taken.
        episodic_return: sum of rewards.
        ended: whether it was over by itself.
        mastered: whether its return was over the threshold.
    """

    task: Task
    steps: int
    episodic_return: float
    ended: bool
    mastered: bool


@dataclass
class _Film:
    board: Board
    size: tuple[int, int]
    played: Played
    episodes: list[PlayedEpisode] = field(default_factory=list)

    def frames(self) -> Iterator[Frame]:
        """Yields a frame every few steps of each episode, its first and its last included."""
        session = self.board.session
        for number in range(len(session.tasks)):
            if number:
                session.next()
            while session.steps < self.played.steps and not session.over:
                if session.steps % self.played.every == 0:
                    yield self.board.picture(self.size)
                session.step()
            yield self.board.picture(self.size)
            self.episodes.append(
                PlayedEpisode(
                    session.task, session.steps, session.episodic_return, session.over, session.mastered
                )
            )


def parse_size(text: str) -> tuple[int, int]:
    """Returns the width and height that "800x600" names.

    Raises:
        ValueError: it names none.
    """
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if found is None:
        raise ValueError(f"size {text!r}: expected width and height in pixels, as in 840x680")
    return int(found[1]), int(found[2])


def play(played: Played) -> None:
    """Shows a policy in a window until it is closed.

    Raises:
        ValueError: no display, no such policy or one that does not fit, an environment that cannot be drawn,
            or a task outside its valid domain; all before a window opens.
    """
    check_display()
    stage, tasks = _open(played)
    try:
        board = Board(Session(stage, tasks, played.seed))
        window = Window(board, played.size or board.best_size, _title(stage))
        try:
            window.run()
        finally:
            window.close()
    finally:
        stage.close()


def film(played: Played, output: Path) -> list[PlayedEpisode]:
    """Plays each task once into the file `output`: .mp4 or .gif, or .png for the last frame; no window opens.

    Raises:
        ValueError: a file that cannot be written, and as `play` does; all before anything is played.
    """
    check_picture(output)
    stage, tasks = _open(played)
    try:
        board = Board(Session(stage, tasks, played.seed), help_shown=False)
        made = _Film(board, played.size or board.best_size, played)
        write_frames(output, made.frames(), stage.frame_rate / played.every)
    finally:
        stage.close()
    return made.episodes


def _open(played: Played) -> tuple[Stage, Sequence[Task]]:
    stage = open_stage(played)
    try:
        rng = np.random.default_rng([played.seed, 0])
        return stage, [parse_task(task, stage.space, stage.domain, rng) for task in played.tasks]
    except ValueError:
        stage.close()
        raise


def _title(stage: Stage) -> str:
    return f"tma_ray: {stage.policy} in {type(stage.environment.unwrapped).__name__}"
