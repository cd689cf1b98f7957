"""Plays a policy in a window, or into a video without one."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import pygame

from tma_ray.commands.arguments import check_names, check_pair
from tma_ray.tasks import Task
from tma_ray.viewing.play.session import Session
from tma_ray.viewing.play.view import SessionView
from tma_ray.viewing.rendering import (
    Frame,
    RenderedEnvironment,
    RenderSettings,
    check_picture,
    open_rendered,
    parse_task,
    write_frames,
)

FRAMES_PER_SECOND: Final = 60
"""At most."""

SMALLEST: Final = (400, 320)
"""Width and height that may be asked for, in pixels; whoever makes a window smaller sees less."""

LARGEST: Final = 8192
"""Width or height that may be asked for, in pixels."""

NO_DISPLAY: Final = "no display: use -o FILE.mp4 or -o FILE.gif to make a video without one"

_WITHOUT_SCREEN: Final = ("dummy", "offscreen")


@dataclass(frozen=True)
class PlaySettings(RenderSettings):
    """Settings of live play: episode k has the seed plus k; `steps` and `every` are of a video.

    Attributes:
        tasks: each as `parse_task` takes it; played one after the other. None is the middle of the space.
        size: width and height of window or video, in pixels; None for one that shows all of the world.
    """

    tasks: tuple[str | None, ...] = (None,)
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_names("tasks", self.tasks)
        if self.size is None:
            return
        check_pair("size", self.size, "width and height, as (640, 480)")
        if any(not least <= pixels <= LARGEST for least, pixels in zip(SMALLEST, self.size, strict=True)):
            smallest, largest = "x".join(map(str, SMALLEST)), f"{LARGEST}x{LARGEST}"
            size = "x".join(map(str, self.size))
            raise ValueError(f"size {size}: expected at least {smallest} and at most {largest} pixels")


@dataclass
class PlayedEpisode:
    """Outcome of an episode of a video.

    Attributes:
        task: that was played (d,).
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
class _Recording:
    view: SessionView
    size: tuple[int, int]
    settings: PlaySettings
    episodes: list[PlayedEpisode] = field(default_factory=list)

    def frames(self) -> Iterator[Frame]:
        """Yields a frame every few steps of each episode, its first and its last included."""
        session = self.view.session
        for number in range(len(session.tasks)):
            if number:
                session.next()
            while session.steps < self.settings.steps and not session.over:
                if session.steps % self.settings.every == 0:
                    yield self.view.picture(self.size)
                session.step()
            yield self.view.picture(self.size)
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


def play(settings: PlaySettings) -> None:
    """Shows a policy in a window until it is closed.

    Raises:
        ValueError: no display, no such policy or one that does not fit, an environment that cannot be drawn,
            or a task outside its valid domain; all before a window opens.
    """
    check_display()
    rendered, tasks = _open(settings)
    try:
        view = SessionView(Session(rendered, tasks, settings.seed))
        window = Window(view, settings.size or view.best_size, _title(rendered))
        try:
            window.run()
        finally:
            window.close()
    finally:
        rendered.close()


def record(settings: PlaySettings, output: Path) -> list[PlayedEpisode]:
    """Plays each task once into the file `output`: .mp4 or .gif, or .png for the last frame; no window opens.

    Raises:
        ValueError: a file that cannot be written, and as `play` does; all before anything is played.
    """
    check_picture(output)
    rendered, tasks = _open(settings)
    try:
        view = SessionView(Session(rendered, tasks, settings.seed), help_shown=False)
        made = _Recording(view, settings.size or view.best_size, settings)
        write_frames(output, made.frames(), rendered.frame_rate / settings.every)
    finally:
        rendered.close()
    return made.episodes


def _open(settings: PlaySettings) -> tuple[RenderedEnvironment, Sequence[Task]]:
    rendered = open_rendered(settings)
    try:
        rng = np.random.default_rng([settings.seed, 0])
        return rendered, [parse_task(task, rendered.space, rendered.domain, rng) for task in settings.tasks]
    except ValueError:
        rendered.close()
        raise


def _title(rendered: RenderedEnvironment) -> str:
    return f"tma_ray: {rendered.policy} in {type(rendered.environment.unwrapped).__name__}"


class Window:
    """Shows a view, whose session goes on.

    Args:
        view: what is shown.
        size: at first; the user may change it.
        title: of the window.

    Raises:
        ValueError: no display is available.
    """

    def __init__(self, view: SessionView, size: tuple[int, int], title: str) -> None:
        check_display()
        self._board = view
        try:
            pygame.display.init()  # no sound, no joysticks
            if pygame.display.get_driver() in _WITHOUT_SCREEN and "SDL_VIDEODRIVER" not in os.environ:
                raise pygame.error("only drivers without a screen")
            pygame.display.set_caption(title)
            self._surface = pygame.display.set_mode(size, pygame.RESIZABLE)
        except pygame.error as error:
            pygame.display.quit()
            raise ValueError(f"{NO_DISPLAY} ({error})") from error
        self._clock = pygame.time.Clock()

    @property
    def surface(self) -> pygame.Surface:
        """The surface that is shown now."""
        return self._surface

    def run(self) -> None:
        """Shows frames until somebody leaves."""
        self._clock.tick()
        while self.turn(self._clock.tick(FRAMES_PER_SECOND) / 1000):
            pass

    def turn(self, seconds: float) -> bool:
        """Takes up what was asked for, goes on for `seconds` and shows that; returns whether to go on."""
        for event in pygame.event.get():
            self._board.handle(event)
        if self._board.open:
            self._board.session.advance(seconds)
            self._surface = pygame.display.get_surface() or self._surface
            if min(self._surface.get_size()) > 0:
                self._board.draw(self._surface, self._clock.get_fps())
            pygame.display.flip()
        return self._board.open

    def close(self) -> None:
        """Closes it, and nothing else of pygame."""
        pygame.display.quit()


def check_display() -> None:
    """Refuses a machine without a display, as far as its environment tells.

    Raises:
        ValueError: there is none.
    """
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    if sys.platform.startswith("linux") and not named:
        raise ValueError(NO_DISPLAY)
