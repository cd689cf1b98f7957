"""The built site as a reader meets it: opened from the file system in headless Chromium, offline."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from blocks import ROOT
from playwright.sync_api import Browser, Page, expect

pytestmark = pytest.mark.slow

LOCAL = ("file:", "data:", "blob:", "about:")
"""Beginnings of addresses that need no network."""

PATIENCE = 120_000
"""Milliseconds: the search index takes its time on a busy machine."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, check=True)
    return folder


@pytest.fixture
def page(site: Path, browser: Browser) -> Iterator[Page]:
    """A page of the site; whatever it complains of or asks the network for fails its test."""
    troubles: list[str] = []
    opened = browser.new_page(viewport={"width": 1280, "height": 900})
    opened.set_default_timeout(PATIENCE)
    opened.on("pageerror", lambda error: troubles.append(str(error)))
    opened.on("request", lambda request: troubles.append(request.url))
    opened.goto((site / "index.html").as_uri())
    yield opened
    opened.close()
    assert not [trouble for trouble in troubles if not trouble.startswith(LOCAL)]


def test_links_lead_from_page_to_page(page: Page) -> None:
    page.locator(".md-tabs").get_by_role("link", name="The benchmark").click()
    page.locator(".md-nav--primary").get_by_role("link", name="Teachers").first.click()
    expect(page.locator("h1").first).to_contain_text("Teachers", timeout=PATIENCE)


def test_search_finds_a_page_and_opens_it(page: Page) -> None:
    page.locator(".md-search__input").click()
    expect(page.locator(".md-search-result__meta")).to_have_text("Type to start searching", timeout=PATIENCE)
    page.locator(".md-search__input").press_sequentially("CleanRL")
    found = page.locator(".md-search-result__item", has_text="training code").first
    expect(found).to_be_visible(timeout=PATIENCE)
    found.locator("a").first.click()
    expect(page.locator("h1").first).to_contain_text("training code", timeout=PATIENCE)


def test_every_page_names_its_version(page: Page) -> None:
    from tma_ray import __version__

    expect(page.locator(".md-copyright")).to_contain_text(f"version {__version__}", timeout=PATIENCE)


def test_leaderboards_draw_differences_and_are_sorted_by_their_headings(page: Page, site: Path) -> None:
    page.goto((site / "leaderboard.html").as_uri())
    table = page.locator(".leaderboard table").first
    expect(page.locator(".leaderboard img[src$='.svg']").first).to_be_visible()
    table.get_by_role("button", name="teacher").click()
    names = table.locator("tbody td:first-child").all_inner_texts()
    assert len(names) >= 8
    assert names == sorted(names, key=str.lower)
    expect(table.locator("th[aria-sort=ascending]")).to_have_text("teacher")
