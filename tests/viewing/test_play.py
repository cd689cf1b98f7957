"""Policies live: what keys and sliders do, what is seen, and videos without a window."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pygame
import pytest
from PIL import Image

from tma_ray.cli import main
from tma_ray.tasks import Dimension
from tma_ray.viewing.play.layout import compute_layout
from tma_ray.viewing.play.playing import PlaySettings, Window, play, record
from tma_ray.viewing.play.session import REST, SPEEDS, Session
from tma_ray.viewing.play.view import SessionView
from tma_ray.viewing.play.widgets import Slider
from tma_ray.viewing.rendering import (
    EpisodeSettings,
    RenderedEnvironment,
    RenderSettings,
    open_rendered,
    render,
)

SIZE = (500, 460)
FRAME = 1 / 50


@pytest.fixture(scope="module")
def rendered() -> Iterator[RenderedEnvironment]:
    opened = open_rendered(RenderSettings(results="nowhere"))
    yield opened
    opened.close()


@pytest.fixture
def session(rendered: RenderedEnvironment) -> Session:
    return Session(rendered, [np.array([1.0, 3.0])], seed=3)


@pytest.fixture
def window(session: Session, monkeypatch: pytest.MonkeyPatch) -> Iterator[Window]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown = Window(SessionView(session), SIZE, "test")
    yield shown
    shown.close()


def press(key: int, text: str = "") -> None:
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key, unicode=text))


def mouse(kind: int, place: tuple[float, float]) -> None:
    pygame.event.post(pygame.event.Event(kind, pos=place, button=1, rel=(0, 0), buttons=(1, 0, 0)))


def pixels(window: Window) -> np.ndarray:
    return pygame.surfarray.array3d(window.surface)


def board_of(window: Window) -> SessionView:
    return window._board


def test_time_passes_at_the_pace_of_the_world(session: Session) -> None:
    for _ in range(10):
        session.advance(FRAME / 2)
    assert session.steps == 5
    session.change_speed(1)
    session.advance(FRAME)
    assert session.steps == 7
    session.change_speed(-100)
    assert session.speed == SPEEDS[0]
    session.advance(3600)  # a machine that slept does not make up for it
    assert session.steps < 9
    session.paused = True
    session.advance(1)
    assert session.steps < 9


def test_an_episode_is_the_same_again_and_that_of_render(session: Session, tmp_path: Path) -> None:
    def played() -> float:
        for _ in range(60):
            session.step()
        return session.episodic_return

    first = played()
    session.restart()
    assert session.steps == 0
    assert played() == first
    episode = render(EpisodeSettings(task="1,3", seed=3, steps=60), tmp_path / "a.png")
    assert episode.episodic_return == first
    session.next()
    assert played() != first


def test_an_ended_episode_rests_and_then_the_next_task_comes(rendered: RenderedEnvironment) -> None:
    session = Session(rendered, [np.array([0.0, 6.0]), np.array([2.0, 1.0])])
    while not session.over:
        session.step()
    steps = session.steps
    session.step()
    session.advance(REST / 2)
    assert (session.steps, session.episode) == (steps, 0)
    session.advance(REST / 2)
    assert (session.steps, session.episode, session.task.tolist()) == (0, 1, [2.0, 1.0])


def test_what_is_mastered_is_told_by_the_threshold(session: Session, rendered: RenderedEnvironment) -> None:
    session.step()
    assert not session.mastered
    assert "not mastered" in SessionView(session).status()
    session.rendered = replace(rendered, threshold=session.episodic_return - 1)
    assert session.mastered
    assert "mastered" in SessionView(session).status()


def test_a_task_outside_the_valid_domain_is_refused(session: Session) -> None:
    with pytest.raises(ValueError, match="obstacle_spacing = 7"):
        session.choose(np.array([0.0, 7.0]))


def test_dragging_a_slider_chooses_a_task_when_it_is_let_go(window: Window) -> None:
    view, session = board_of(window), board_of(window).session
    window.turn(5 * FRAME)
    assert session.steps == 5
    slider = view.sliders[0]
    y = slider.area.top + 27
    mouse(pygame.MOUSEBUTTONDOWN, (slider.x_of(1.0), y))
    mouse(pygame.MOUSEMOTION, (slider.x_of(6.0), y + 200))
    window.turn(FRAME)
    assert slider.value == pytest.approx(6.0, abs=0.1)
    assert session.task.tolist() == [1.0, 3.0]
    assert session.steps == 6
    mouse(pygame.MOUSEBUTTONUP, (slider.x_of(8.0), y + 200))
    window.turn(0)
    assert session.task == pytest.approx([8.0, 3.0], abs=0.1)
    assert session.steps == 0
    assert session.episode == 1
    mouse(pygame.MOUSEBUTTONDOWN, (slider.area.centerx, y))
    mouse(pygame.MOUSEBUTTONUP, (-100, y))  # outside the window
    window.turn(0)
    assert session.task == pytest.approx([-3.0, 3.0])
    mouse(pygame.MOUSEBUTTONUP, (slider.area.centerx, y))  # of nothing that was dragged
    window.turn(0)
    assert session.task == pytest.approx([-3.0, 3.0])


def test_keys(window: Window) -> None:
    view, session = board_of(window), board_of(window).session
    press(pygame.K_SPACE, " ")
    window.turn(FRAME)
    assert session.paused
    assert "paused" in view.status()
    press(pygame.K_s, "s")
    press(pygame.K_s, "S")
    window.turn(FRAME)
    assert session.steps == 2
    press(pygame.K_SPACE, " ")
    press(pygame.K_s, "s")  # time goes on by itself
    press(pygame.K_PLUS, "+")
    window.turn(FRAME)
    assert (session.steps, session.speed) == (4, 2.0)
    press(pygame.K_MINUS, "-")
    press(pygame.K_r, "r")
    window.turn(0)
    assert (session.steps, session.speed, session.episode) == (0, 1.0, 0)
    press(pygame.K_n, "n")
    window.turn(0)
    assert session.task.tolist() != [1.0, 3.0]
    assert session.rendered.space.contains(session.task)
    assert view.sliders[0].value == session.task[0]


def test_lidars_can_be_hidden(window: Window) -> None:
    window.turn(0)
    red = (214, 74, 62)

    def reddish() -> int:
        return int((np.abs(pixels(window).astype(int) - red).max(axis=-1) < 40).sum())

    before = reddish()
    press(pygame.K_l, "l")
    window.turn(0)
    assert reddish() < before / 2
    press(pygame.K_l, "l")
    window.turn(0)
    assert reddish() == before


@pytest.mark.parametrize("how", ["q", "escape", "frame"])
def test_the_window_closes(window: Window, how: str) -> None:
    assert window.turn(FRAME)
    if how == "frame":
        pygame.event.post(pygame.event.Event(pygame.QUIT))
    else:
        press(*((pygame.K_q, "q") if how == "q" else (pygame.K_ESCAPE, "\x1b")))
    assert not window.turn(FRAME)


def test_what_is_seen_changes(window: Window) -> None:
    seen = []
    for _ in range(4):
        window.turn(2 * FRAME)
        seen.append(pixels(window))
    for before, after in pairwise(seen):
        assert np.any(before != after, axis=-1).sum() > 100
    assert seen[0].shape == (*SIZE, 3)
    assert pygame.mixer.get_init() is None


def test_the_window_may_change_its_size(window: Window) -> None:
    window.turn(0)
    before = board_of(window).sliders[0].area.copy()
    pygame.display.set_mode((900, 700), pygame.RESIZABLE)
    window.turn(0)
    assert pixels(window).shape == (900, 700, 3)
    assert board_of(window).sliders[0].area.width > before.width


def test_the_command_ends_well_when_its_window_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    seen = []

    def shut(view: SessionView, event: pygame.event.Event) -> None:
        handle(view, event)
        view.open = False

    def turn(window: Window, seconds: float) -> bool:
        seen.append(window.surface.get_size())
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        return original(window, seconds)

    handle, original = SessionView.handle, Window.turn
    monkeypatch.setattr(Window, "turn", turn)
    assert main(["play", "--size", "600x500", "--task", "1,2", "--policy", "zero"]) == 0
    assert seen == [(600, 500)]
    assert not pygame.display.get_init()


@pytest.mark.parametrize("size", [(840, 760), (400, 320), (480, 900), (1600, 600), (700, 420)])
@pytest.mark.parametrize("count", [1, 2, 6, 9])
def test_nothing_overlaps(size: tuple[int, int], count: int) -> None:
    places = compute_layout(size, (600, 400), count, lambda width: 2 if width > 400 else 4)
    areas = [*places.sliders, places.text]
    assert not any(first.colliderect(second) for i, first in enumerate(areas) for second in areas[:i])
    assert all(places.panel.contains(area) for area in areas)
    assert not places.world.colliderect(places.panel)
    assert places.world.width == pytest.approx(places.world.height * 1.5, abs=2)
    if size != (400, 320):
        assert places.world.width >= 150
        assert pygame.Rect(0, 0, *size).contains(places.panel)


@pytest.mark.parametrize("width", [90, 140, 300])
def test_long_names_stay_inside_their_slider(width: int) -> None:
    dimension = Dimension(
        "a_very_long_name_of_a_dimension_indeed", -1234.5, 98765.25, "shares of a long unit"
    )
    slider = Slider(dimension, (0, 10), -1234.5)
    slider.area = pygame.Rect(50, 40, width, 56)
    surface = pygame.Surface((width + 100, 136))
    surface.fill((255, 255, 255))
    slider.draw(surface)
    drawn = (pygame.surfarray.array3d(surface) != 255).any(axis=-1)
    assert drawn[50 : 50 + width, 40:96].sum() > 100
    drawn[50 : 50 + width, 40:96] = False
    assert not drawn.any()


def test_sliders_are_for_what_varies_and_mark_the_task_space() -> None:
    rendered = open_rendered(RenderSettings("zero", "nowhere", "parkour", "fish"))
    view = SessionView(Session(rendered, [rendered.space.centre]))
    names = [slider.domain.name for slider in view.sliders.values()]
    assert names == ["theta_1", "theta_2", "theta_3", "water_level", "creepers_height", "creepers_spacing"]
    first = view.sliders[0]
    assert (first.domain.low, first.domain.high, *first.usual) == (-2, 2, -0.35, 0.05)
    rendered.close()


def test_a_video_shows_the_tasks_one_after_the_other(tmp_path: Path) -> None:
    path = tmp_path / "a.gif"
    settings = PlaySettings(tasks=("0.5,3", "1,4"), policy="zero", steps=9, every=4, size=(420, 400))
    first, second = record(settings, path)
    assert [first.task.tolist(), second.task.tolist()] == [[0.5, 3.0], [1.0, 4.0]]
    assert first.steps == second.steps == 9
    with Image.open(path) as gif:
        assert gif.size == (420, 400)
        assert gif.n_frames == 2 * 4  # after 0, 4, 8 and 9 steps
        assert gif.info["duration"] == 80
    assert not pygame.display.get_init()


def test_an_mp4_is_the_same_for_the_same_seed(tmp_path: Path) -> None:
    frames = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        record(PlaySettings(seed=seed, steps=6, every=2, size=(420, 400)), tmp_path / f"{name}.mp4")
        with av.open(str(tmp_path / f"{name}.mp4")) as video:
            frames.append([frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)])
    assert [len(each) for each in frames] == [4, 4, 4]
    assert frames[0][0].shape == (400, 420, 3)
    np.testing.assert_array_equal(frames[0], frames[1])
    assert np.any(frames[0][-1] != frames[2][-1])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "no display: use -o FILE.mp4"),
        ("-o a.avi", "a.avi"),
        ("-o a.gif --task 3,99", "obstacle_spacing = 99"),
        ("-o a.gif --size 20x20", "at least 400x320"),
        ("-o a.gif --size huge", "'huge'"),
        ("-o a.gif --seed -1", "--seed: '-1': expected a whole number"),
        ("-o a.gif --policy nobody --results missing", "a results root"),
        ("-o a.gif --environment parkuor", "parkour"),
    ],
)
def test_the_command_refuses_before_anything_opens(
    arguments: str,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    assert main(["play", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
    assert not pygame.display.get_init()


def test_a_task_is_refused_before_a_window_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with pytest.raises(ValueError, match="stump_height = 99"):
        play(PlaySettings(tasks=("99,1",)))
    assert not pygame.display.get_init()
    monkeypatch.setenv("SDL_VIDEODRIVER", "nonsense")
    with pytest.raises(ValueError, match="no display: use -o"):
        play(PlaySettings())


def test_the_command_says_how_it_went(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.png"
    arguments = ["--embodiment", "spider", "--steps", "3", "--task", "random", "--task", "0,6"]
    assert main(["play", *arguments, "-o", str(path)]) == 0
    assert path.read_bytes().startswith(b"\x89PNG")
    said = capsys.readouterr().out
    assert said.count("left after 3 steps") == 2
    assert "task 0, 6:" in said
