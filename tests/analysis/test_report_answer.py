"""The beginning of a report: its title, the answer over all challenges, a row for each comparison."""

from __future__ import annotations

from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign

from analysis import load
from analysis.baselines import add_to_release
from analysis.comparisons.pairwise import pairwise
from analysis.data.reference import BASELINE
from analysis.formatting import number
from analysis.measures.pooling import runs_after
from analysis.measures.tested import AXES, FINAL, verdict
from analysis.pages.report import subject, write_report
from analysis.pages.sections import answers

COUNTS = {"random": (1, 2, 1, 2), "adr": (7, 8, 7, 8), "riac": (1, 1, 2, 2)}
"""Mastered tasks of ten, seed by seed."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two campaigns, each of one challenge; ADR is better than Random on the first alone."""
    folder = tmp_path_factory.mktemp("answer") / "hills"
    for challenge in ("original", "mostly_trivial"):
        campaign = SyntheticCampaign(folder, experiment=challenge, campaign=f"on_{challenge}", steps=1000)
        for teacher, counts in COUNTS.items():
            alike = COUNTS["random"] if challenge == "mostly_trivial" else counts
            campaign.seeds(teacher, alike, level="high", challenge=challenge)
    return folder


def test_a_report_is_called_by_its_campaign_its_folder_or_its_release(root: Path) -> None:
    assert subject(root, ["first_look"]) == "First look"
    assert subject(root, ["on_mostly_trivial", "on_original"]) == "hills"
    assert subject(root, []) == "Training runs"
    release = add_to_release(root, "peaks", "one", root.parent, "CC0-1.0")
    assert subject([root, release], ["on_mostly_trivial", "on_original"]) == "hills, peaks"


def test_the_matrix_has_every_test_against_random_over_all_challenges_and_on_each(root: Path) -> None:
    frames = load(root)
    (answer,) = answers(frames)
    assert answer.sentence.startswith("The best teacher, sooner and in the end, is ADR (probability 0.99)")
    assert [row.name for row in answer.rows] == ["ADR", "RIAC"]
    assert answer.challenges == ["Mostly trivial", "Original"]
    cells = {
        row.teacher: dict(zip(("all", *answer.challenges), row.cells, strict=True)) for row in answer.rows
    }
    for place, axis in enumerate((FINAL, *(axis for axis in AXES if axis != FINAL))):
        tests = pairwise(runs_after(frames), axis, BASELINE)
        for _, test in tests.iterrows():
            title = "Original" if test["challenge"] == "original" else "Mostly trivial"
            cell = cells[test["first"]][title][place]
            assert cell.text == number(test["difference"])
            assert cell.decided == {"better": "better", "worse": "worse"}.get(verdict(test), "")
    assert cells["adr"]["all"][0].decided == cells["adr"]["Original"][0].decided == "better"
    assert cells["adr"]["Mostly trivial"][0].decided == ""


def test_a_report_of_several_comparisons_begins_with_the_answer_and_folds_them(root: Path) -> None:
    page = write_report(root).read_text()
    assert "<h1>hills</h1>" in page
    assert "2 campaigns</summary>" in page
    places = [page.index(text) for text in ("The best teacher", 'class="matrix"', 'id="overview-section"')]
    assert places == sorted(places)
    assert page.count('<details class="comparison">') == 2 + 1  # and the chart of all
    rows = page[places[-1] : page.index("</tbody>", places[-1])]
    assert rows.count("<tr data-comparison=") == 2
    assert "ADR" in rows
