"""Pages of more teachers than fit a screen: the best are shown at first, the others on demand."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest
from synthetic_results import SyntheticCampaign

from analysis.comparisons.comparison import leading
from analysis.formatting import listed
from analysis.pages.compare import write_comparison
from analysis.pages.report import write_report

TEACHERS = ("random", *(f"teacher_{number:02d}" for number in range(13)))


def test_of_many_teachers_random_and_the_best_are_shown_at_first() -> None:
    few = pd.DataFrame({"teacher": list("abc"), "mean": [1.0, 2.0, float("nan")]})
    assert leading(few, "mean", "abcd") == {"a", "b", "c", "d"}  # one has not begun
    many = pd.DataFrame({"teacher": TEACHERS * 2, "mean": [float(place) for place in range(14)] * 2})
    assert leading(many, "mean", TEACHERS) == {"random", *TEACHERS[-8:]}
    assert leading(many.head(0), "mean", ()) == set()
    apart = pd.DataFrame({"teacher": ["teacher_00", "teacher_01"], "mean": [1.0, 2.0], "challenge": "b"})
    both = pd.concat([many.assign(challenge="a"), apart])
    assert leading(both, "mean", TEACHERS, ["challenge"]) == {"random", "teacher_01", *TEACHERS[-8:]}


def test_long_lists_are_cut_and_say_by_how_much() -> None:
    assert listed("abc") == "a, b, c"
    assert listed(TEACHERS[1:]) == f"{', '.join(TEACHERS[1:7])} and 7 more"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("many")
    campaign = SyntheticCampaign(folder, experiment="original", steps=1000)
    for place, teacher in enumerate(TEACHERS):
        campaign.seeds(teacher, [place] * 2, 14, level="none")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "write", [write_report, lambda root: write_comparison(root, ["paper-2021"])], ids=["report", "compare"]
)
def test_a_page_of_many_teachers_is_short_to_read(write: Callable[[Path], Path], root: Path) -> None:
    text = write(root).read_text()
    checked = re.findall(r'<input type="checkbox" checked data-teacher="(\w+)">', text)
    assert set(checked) == {"random", *TEACHERS[-8:]}
    assert len(re.findall(r'<input type="checkbox" data-teacher="(\w+)">', text)) == 5
    assert "5 more</summary>" in text
    open_sentences = re.sub(r"<details>.*?</details>", "", text, flags=re.DOTALL)
    said = re.findall(r"<p>(?:<b>)?[^<]*(?:Over 1 challenge|is better than|distinguishable)", open_sentences)
    assert len(said) <= 24
