"""The view of a session: the world, sliders and text in a picture of any size; mouse and keys act on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import pygame

from tma_ray.envs import Look
from tma_ray.envs.drawing import GRIP_HOLDING, Colour, pixels_of
from tma_ray.viewing.play.layout import LINE, Layout, compute_layout, panel_height
from tma_ray.viewing.play.session import Session
from tma_ray.viewing.play.widgets import FAINT, INK, TEXT_SIZE, Slider, draw_text, font, signed, wrapped
from tma_ray.viewing.rendering import Frame

PAPER: Final[Colour] = (247, 248, 250)
DARK: Final[Colour] = (226, 230, 236)
MASTERED: Final[Colour] = (34, 120, 44)

HELP: Final = ("Space pause", "S one step", "R again", "N other task", "+ \N{MINUS SIGN} speed", "Q quit")
LIDARS_HELP: Final = "L lidars"

WIDTH: Final = 840
"""Of a window or video whose size was not given, in pixels."""


class SessionView:
    """Draws a session and lets it be changed.

    Sliders are for the dimensions that vary in the task space.

    Args:
        session: what is played.
        help_shown: whether keys are explained.

    Attributes:
        session: what is played.
        sliders: by the index of their dimension.
        open: False once somebody wants to leave.
    """

    def __init__(self, session: Session, help_shown: bool = True) -> None:
        self.session, self.open = session, True
        rendered = session.rendered
        self._environment = rendered.environment
        self._can_look = self._environment.has_wrapper_attr("look")
        if self._can_look:
            self._see(replace(self._look, smooth=False))
        frame = rendered.frame()
        self._frame_size = frame.shape[1], frame.shape[0]
        help_line = [*HELP[:-1], LIDARS_HELP, HELP[-1]] if self._can_look else list(HELP)
        self._help = help_line if help_shown else []
        self.sliders = {
            index: Slider(rendered.domain.dimensions[index], (dimension.low, dimension.high), 0.0)
            for index, dimension in enumerate(rendered.space.dimensions)
            if dimension.high > dimension.low
        }
        self._keys = self._bindings()

    @property
    def best_size(self) -> tuple[int, int]:
        """Size at which the world takes the whole width."""
        height = WIDTH * self._frame_size[1] // self._frame_size[0]
        whole = height + panel_height(WIDTH, len(self.sliders), self._line_count)
        return WIDTH, whole + whole % 2

    def handle(self, event: pygame.event.Event) -> None:
        """Does what the mouse, a key or the window's frame asks for."""
        if event.type == pygame.QUIT:
            self.open = False
        elif event.type == pygame.KEYDOWN:
            action = self._keys.get(event.unicode.lower()) or self._keys.get(event.key)
            if action is not None:
                action()
        for index, slider in self.sliders.items():
            if slider.handle(event):
                task = self.session.task.copy()
                task[index] = slider.value
                self.session.choose(self.session.rendered.domain.clip(task))

    def layout(self, size: tuple[int, int]) -> Layout:
        """Returns where everything is on a surface of some size."""
        return compute_layout(size, self._frame_size, len(self.sliders), self._line_count)

    def draw(self, surface: pygame.Surface, frames_per_second: float | None = None) -> None:
        """Draws everything.

        Args:
            surface: of any size.
            frames_per_second: how often this is drawn; not shown if None.
        """
        places = self.layout(surface.get_size())
        surface.fill(DARK)
        self._draw_world(surface, places.world)
        surface.fill(PAPER, places.panel)
        for (index, slider), area in zip(self.sliders.items(), places.sliders, strict=True):
            slider.area = area
            if not slider.dragged:
                slider.value = float(self.session.task[index])
            slider.draw(surface)
        self._write(surface, places.text, frames_per_second)

    def picture(self, size: tuple[int, int]) -> Frame:
        """Returns everything as a frame of some size (height, width, 3)."""
        surface = pygame.Surface(size)
        self.draw(surface)
        return pixels_of(surface)

    def status(self, frames_per_second: float | None = None) -> list[str]:
        """Returns what is going on, in a few words each."""
        session = self.session
        parts = [signed(f"return {session.episodic_return:.1f}"), f"step {session.steps:,}"]
        parts.append("mastered" if session.mastered else "not mastered")
        parts.append(f"episode {session.episode + 1}")
        if session.over:
            parts.append("ended")
        if session.paused:
            parts.append("paused")
        if session.speed != 1:
            parts.append(f"speed {session.speed:g}")
        if frames_per_second is not None:
            parts.append(f"{frames_per_second:.0f} fps")
        return parts

    def _bindings(self) -> Mapping[str | int, Callable[[], None]]:
        session = self.session
        return {
            " ": self._pause,
            "s": self._step,
            "r": session.restart,
            "n": session.choose_randomly,
            "+": lambda: session.change_speed(1),
            "=": lambda: session.change_speed(1),  # where + is on the same key
            "-": lambda: session.change_speed(-1),
            "l": self._switch_lidars,
            "q": self._leave,
            pygame.K_ESCAPE: self._leave,
            pygame.K_KP_PLUS: lambda: session.change_speed(1),
            pygame.K_KP_MINUS: lambda: session.change_speed(-1),
        }

    def _pause(self) -> None:
        self.session.paused = not self.session.paused

    def _step(self) -> None:
        if self.session.paused:
            self.session.step()

    def _leave(self) -> None:
        self.open = False

    @property
    def _look(self) -> Look:
        look: Look = self._environment.get_wrapper_attr("look")
        return look

    def _see(self, look: Look) -> None:
        self._environment.set_wrapper_attr("look", look)

    def _switch_lidars(self) -> None:
        if self._can_look:
            self._see(replace(self._look, lidars=not self._look.lidars))

    def _draw_world(self, surface: pygame.Surface, place: pygame.Rect) -> None:
        if min(place.size) < 1:
            return
        frame = self.session.rendered.frame()
        drawn = pygame.image.frombuffer(frame.tobytes(), (frame.shape[1], frame.shape[0]), "RGB")
        surface.blit(pygame.transform.smoothscale(drawn, place.size), place)

    def _line_count(self, width: int) -> int:
        help_lines = len(wrapped(self._help, width, font(TEXT_SIZE)))
        return 1 + help_lines  # of the status as much as fits a line

    def _write(self, surface: pygame.Surface, place: pygame.Rect, frames_per_second: float | None) -> None:
        letters, session = font(TEXT_SIZE), self.session
        status = wrapped(self.status(frames_per_second), place.width, letters)
        colour = MASTERED if session.mastered else GRIP_HOLDING if session.over else INK
        draw_text(surface, status[0], place.topleft, letters, colour)
        for number, line in enumerate(wrapped(self._help, place.width, letters), start=1):
            draw_text(surface, line, (place.left, place.top + number * LINE), letters, FAINT)
