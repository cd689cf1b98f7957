"""Links and pictures of all pages lead somewhere, in the repository as in the site."""

from __future__ import annotations

import re

import pytest
from blocks import FENCE, PAGES, ROOT

LINK = re.compile(r"\]\(((?!\w+:)[^)\s]+)\)")


def slug(heading: str) -> str:
    """Return the anchor of a heading."""
    text = re.sub(r"[`*]|\(http.*?\)", "", heading).lower()
    return re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", text).strip())


def anchors(page: str) -> set[str]:
    text = FENCE.sub("", (ROOT / page).read_text())
    return {slug(heading) for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    text = FENCE.sub("", (ROOT / page).read_text())
    for target in LINK.findall(text):
        file, _, anchor = target.partition("#")
        path = ((ROOT / page).parent / file).resolve() if file else ROOT / page
        assert path.exists(), f"{page}: {target}"
        assert not anchor or anchor in anchors(path.relative_to(ROOT).as_posix()), f"{page}: {target}"


@pytest.mark.parametrize("page", PAGES)
def test_pictures_are_there_and_small(page: str) -> None:
    for picture in re.findall(r"!\[.+?\]\((.+?)\)", (ROOT / page).read_text()):
        size = ((ROOT / page).parent / picture).stat().st_size
        assert 1_000 < size < 700_000, f"{page}: {picture} has {size} bytes"
