"""The playground as a visitor meets it: in headless Chromium, on a desk and on a phone."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from playwright.sync_api import Browser, Page, expect

from tma_ray.playground.page import network_record, policy_page
from tma_ray.runs.checkpoints import find_policy
from tma_ray.viewing.play import PlaySettings, play

ROOT = Path(__file__).parents[2]

POLICY = ROOT / "notebooks/data/ppo-lite/policies/ppo_random-s0-43ca06a21b5e"
"""Of a run whose results lie next to it."""

LIMIT = 1_000_000
"""Largest size of a page with one policy, in bytes."""

DESK, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
Opener = Callable[..., Page]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page that an export makes."""
    written = tmp_path_factory.mktemp("page") / "playground.html"
    written.write_text(policy_page(find_policy(str(POLICY), "results"), "results"), encoding="utf-8")
    return written


@pytest.fixture
def opened(browser: Browser, file: Path) -> Iterator[Opener]:
    """Open the page, paused; an error of it or a request to the network fails the test."""
    troubles: list[str] = []
    pages: list[Page] = []

    def opener(size: Any = DESK, mode: Literal["light", "dark"] = "light", path: Path = file) -> Page:
        page = browser.new_page(viewport=size, color_scheme=mode)
        page.on("pageerror", lambda error: troubles.append(str(error)))
        page.on("request", lambda request: troubles.append(request.url))
        page.goto(path.as_uri())
        page.wait_for_function("window.playground")
        page.keyboard.press("Space")
        expect(page.locator("#play")).to_have_text("Play")
        pages.append(page)
        return page

    yield opener
    for page in pages:
        page.close()
    assert not [each for each in troubles if not each.startswith(("file:", "data:", "blob:"))]


def say(page: Page, code: str) -> Any:
    """Return a value of the page's state."""
    return page.evaluate(f"() => {{ const p = window.playground; return {code}; }}")


def test_one_policy_and_every_body_are_one_file_under_a_megabyte(file: Path) -> None:
    assert file.stat().st_size < LIMIT


def test_keys_play_step_restart_and_push(opened: Opener) -> None:
    page = opened()
    before = say(page, "p.runners[0].steps")
    page.keyboard.press("s")
    assert say(page, "p.runners[0].steps") == before + 1
    speed = "p.runners[0].engine.view('state')[6 * p.body.head + 3]"
    still = say(page, speed)
    page.keyboard.press("ArrowRight")
    page.keyboard.press("s")
    assert say(page, speed) > still + 0.3
    page.keyboard.press("r")
    assert say(page, "p.runners[0].steps") == 0
    page.keyboard.press("+")
    expect(page.locator("#speed")).to_have_text(re.compile("^2 "))
    page.keyboard.press("Space")
    page.wait_for_function("window.playground.runners[0].steps > 20")


def test_a_task_is_chosen_by_slider_plane_and_chance(opened: Opener) -> None:
    page = opened()
    page.locator("#sliders input").first.fill("1.5")
    assert say(page, "p.task[0]") == 1.5
    box = page.locator("#plane").bounding_box()
    assert box
    page.mouse.click(box["x"] + 42, box["y"] + 12)
    assert say(page, "p.task[0]") < 0.1
    assert say(page, "p.task[1]") > 5.8
    page.locator("#another").click()
    assert say(page, "p.task[1]") < 5.8
    assert say(page, "p.chosen[0].tests.length") == 100
    assert say(page, "p.chosen[0].curriculum.length") > 2
    expect(page.locator("#traced")).to_have_text("random, seed 0")


def test_the_curriculum_is_shown_over_time(opened: Opener) -> None:
    page = opened()
    shown = page.locator("#step-shown")
    at_last = shown.text_content()
    page.locator("#probe").fill("0")
    expect(shown).not_to_have_text(str(at_last))
    page.locator(".policy", has_text="no torque").click()
    expect(shown).to_have_text(str(at_last))
    expect(page.locator("#probe")).to_have_value("1")


@pytest.mark.slow
def test_drags_choose_a_task_and_push_the_nearest_body(opened: Opener) -> None:
    page = opened()
    box = page.locator("#plane").bounding_box()
    assert box
    page.mouse.move(box["x"] + 60, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 60, steps=4)
    page.mouse.up()
    assert say(page, "p.task[0]") > 1
    place = "p.camera[0].place(...p.runners[0].engine.view('state').subarray(6 * p.body.head))"
    speed = "p.runners[0].engine.view('state')[6 * p.body.head + 3]"
    world, (x, y), still = page.locator("#world").bounding_box(), say(page, place), say(page, speed)
    assert world
    page.mouse.move(world["x"] + x, world["y"] + y)
    page.mouse.down()
    page.mouse.move(world["x"] + x + 60, world["y"] + y, steps=4)
    page.mouse.up()
    page.keyboard.press("s")
    assert say(page, speed) > still + 0.3


@pytest.mark.slow
def test_several_policies_run_in_one_world(opened: Opener) -> None:
    page = opened()
    page.locator(".policy", has_text="no torque").click()
    page.locator(".policy", has_text="uniform actions").click()
    page.keyboard.press("o")
    for _ in range(12):
        page.keyboard.press("s")
    assert say(page, "p.runners.length") == 3
    assert len(set(say(page, "p.runners.map((runner) => runner.x)"))) == 3
    expect(page.locator(".policy em.good, .policy em.over, .policy em:not(:empty)")).to_have_count(3)


@pytest.mark.slow
def test_ground_is_drawn_by_hand(opened: Opener) -> None:
    page = opened()
    page.keyboard.press("d")
    box = page.locator("#world").bounding_box()
    assert box
    x, y = box["x"] + 0.8 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y - 40, steps=4)
    page.mouse.up()
    assert say(page, "Math.max(...p.heights)") > say(page, "p.heights[0]") + 1
    assert say(page, "p.runners[0].steps") == 0
    page.get_by_role("button", name="Clear drawing").click()
    assert say(page, "p.heights") is None


@pytest.mark.slow
def test_body_size_and_environment_change(opened: Opener) -> None:
    page = opened()
    page.locator("#body").select_option("fish")
    page.locator("#environment").select_option("parkour")
    assert say(page, "[p.runners[0].body.motors, p.task.length]") == [4, 8]
    expect(page.locator("#sliders input")).to_have_count(6)
    page.keyboard.press("s")
    page.locator(".policy", has_text="classic bipedal").click()
    shown = say(page, "[p.environment, p.bodyName, p.chosen[0].name]")
    assert shown == ["stump_tracks", "classic_bipedal", POLICY.name]
    height = "p.body.built.vertices[2].reduce((a, b) => Math.max(a, b))"
    small = say(page, height)
    page.locator("#size").select_option("classic_bipedal:size=1.6")
    assert say(page, height) == pytest.approx(1.6 * small)
    page.keyboard.press("s")
    assert say(page, "p.runners[0].over") == ""


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["light", "dark"])
def test_it_fits_a_phone_by_day_and_night(mode: Literal["light", "dark"], opened: Opener) -> None:
    page = opened(PHONE, mode)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    ink = page.evaluate("getComputedStyle(document.body).color")
    assert (sum(map(int, ink[4:-1].split(","))) > 384) == (mode == "dark")
    page.locator("#lidars").click()
    assert say(page, "p.lidars")


def test_play_writes_what_was_asked_for(tmp_path: Path, opened: Opener) -> None:
    asked = PlaySettings((str(POLICY), "zero"), task="stump_height=0.25", seed=7)
    page = opened(path=play(asked, tmp_path / "page.html"))
    shown = say(page, "[p.task[0], p.seed, p.chosen.map((each) => each.name)]")
    assert shown == [0.25, 7, [POLICY.name, "zero"]]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (PlaySettings((str(POLICY),), embodiment="fish"), "does not fit stump_tracks with fish"),
        (PlaySettings(environment="gymnasium:Env"), "the playground has stump_tracks and parkour"),
        (PlaySettings(task="stump_height=12"), "outside its valid domain"),
        (PlaySettings(("nowhere",)), "no policy 'nowhere'"),
    ],
)
def test_what_the_page_cannot_play_is_refused(settings, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # elsewhere there may be results, whose runs the last message tells
    with pytest.raises(ValueError, match=message):
        play(settings)


def test_other_networks_are_refused() -> None:
    from torch import nn

    with pytest.raises(ValueError, match="Linear, GELU, Linear: the playground has"):
        network_record(nn.Sequential(nn.Linear(2, 2), nn.GELU(), nn.Linear(2, 1)))
