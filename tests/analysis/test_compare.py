"""One's own results among baselines: what is compared, what stands apart, what is said."""

import itertools
import re
import shutil
from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign, mastering
from views import Told, addresses_in, unpacked

from analysis.baselines import release
from analysis.comparisons.sentences import sentences
from analysis.comparisons.sources import (
    baseline_results,
    comparable_runs,
    head_to_head,
    incomparable,
    missing_challenges,
    new_teachers,
    reference_only,
    result_set,
)
from analysis.data.loading import load
from analysis.pages.compare import write_comparison

CHALLENGES = ("mostly_unfeasible", "mostly_trivial", "rugged_difficulty")


def write(root: Path, teacher: str, mastered: dict[str, list[int]], steps: int = 2_000_000) -> None:
    """Write finished runs that master so many of ten test tasks, by challenge."""
    for challenge, counts in mastered.items():
        campaign = SyntheticCampaign(root, experiment=challenge, steps=steps, prefix=f"{root.name}-")
        campaign.seeds(teacher, counts, level="none", challenge=challenge)


@pytest.fixture(scope="module")
def roots(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Mine, with a new teacher; and others' with Random, RIAC and runs of another budget."""
    folder = tmp_path_factory.mktemp("roots")
    mine, theirs = folder / "mine", folder / "lite"
    good, bad, same = [7, 8, 7, 8], [1, 2, 1, 2], [4, 5, 5, 4]
    write(mine, "frontier", dict(zip(CHALLENGES, (good, good, bad), strict=True)))
    write(theirs, "random", dict.fromkeys(CHALLENGES, same))
    write(theirs, "riac", dict(zip(CHALLENGES, (good, same, same), strict=True)))
    write(theirs, "alp_gmm", {CHALLENGES[0]: good}, steps=4_000_000)
    return mine, theirs


def test_a_new_teacher_is_tested_against_comparable_baselines_only(roots: tuple[Path, Path]) -> None:
    mine, theirs = (result_set(load(root), root.name) for root in roots)
    runs = comparable_runs(mine, [theirs, baseline_results("paper-2021")])
    assert set(runs["teacher"]) == {"frontier", "random", "riac"}
    assert new_teachers(mine) == ["frontier"]
    assert sentences(head_to_head(runs, ["frontier"])) == [
        "Stump Tracks, expert knowledge none: frontier is better than Random on 2 of 3 challenges, worse on "
        "1 (p < 0.05 after Holm; few seeds).",
        "Stump Tracks, expert knowledge none: frontier is better than RIAC on 1 of 3 challenges, worse on "
        "1 (p < 0.05 after Holm; few seeds).",
    ]


def test_other_budgets_and_engines_are_set_beside_and_named(roots: tuple[Path, Path]) -> None:
    mine, theirs = (result_set(load(root), root.name) for root in roots)
    (apart,) = reference_only(mine, theirs).itertuples()
    assert (apart.teacher, apart.challenge, apart.differs) == (
        "alp_gmm", "mostly_unfeasible", "training steps: 4 million",
    )  # fmt: skip
    paper = reference_only(mine, baseline_results("paper-2021"))
    assert set(paper["challenge"]) == set(CHALLENGES)
    assert set(paper["differs"]) == {"engine Box2D; 20 million steps"}


def test_my_runs_replace_those_of_a_baselines_teacher(roots: tuple[Path, Path], tmp_path: Path) -> None:
    mine, theirs = shutil.copytree(roots[0], tmp_path / "mine"), roots[1]
    write(mine, "random", {CHALLENGES[0]: [3, 3, 4, 4]})
    runs = comparable_runs(result_set(load(mine), "mine"), [result_set(load(theirs), "lite")])
    random = runs[runs["teacher"] == "random"]
    assert dict(zip(random["challenge"], random["source"], strict=True)) == {
        "mostly_unfeasible": "mine", "mostly_trivial": "lite", "rugged_difficulty": "lite",
    }  # fmt: skip


def test_what_cannot_be_compared_has_a_reason(roots: tuple[Path, Path], tmp_path: Path, told: Told) -> None:
    short = tmp_path / "short"
    write(short, "frontier", {CHALLENGES[0]: [1, 2, 3]}, steps=20_000)
    sides = result_set(load(short), "yours"), [result_set(load(roots[1]), "lite")]
    assert incomparable(*sides, comparable_runs(*sides)) == [
        "Nothing of lite may be compared with yours: training steps 2 million, 4 million, yours 20 thousand. "
        "For results that may: tma-ray campaign --like lite --teachers MODULE:NAME"
    ]
    mine = result_set(load(roots[0]), "yours")
    assert incomparable(mine, sides[1], comparable_runs(mine, sides[1])) == []
    said = told(0, "compare", short, "--baseline", "paper-2021")
    assert "frontier has no rank: no other teacher has results on the same challenges" in said
    assert "nothing to compare" not in said
    assert "ranks 1 of 1" not in said


def test_what_is_said_of_several_teachers_is_said_once(tmp_path: Path) -> None:
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    write(mine, "frontier", {CHALLENGES[0]: [4, 5, 5, 6]})
    for teacher in ("random", "riac", "adr"):
        write(theirs, teacher, {CHALLENGES[0]: [4, 5, 5, 6]})
    write(theirs, "alp_gmm", {CHALLENGES[0]: [1, 1, 1, 2]})
    runs = comparable_runs(result_set(load(mine), "yours"), [result_set(load(theirs), "theirs")])
    assert sentences(head_to_head(runs, ["frontier"])) == [
        "Stump Tracks, expert knowledge none: frontier is not distinguishable from Random, ADR, RIAC on any "
        "of 1 challenge (few seeds).",
        "Stump Tracks, expert knowledge none: frontier is better than ALP-GMM on 1 of 1 challenge "
        "(p < 0.05 after Holm; few seeds).",
    ]


def test_a_ranking_marks_teachers_of_ones_own(roots: tuple[Path, Path], tmp_path: Path, told: Told) -> None:
    assert "yours" not in told(0, "ranking", *roots)  # two results roots, no baseline
    baseline = release(roots[1], "theirs", tmp_path)
    lines = told(0, "ranking", roots[0], baseline).splitlines()
    marked = [before.split()[0] for before, line in itertools.pairwise(lines) if "← yours" in line]
    assert marked[-len(CHALLENGES) :] == ["frontier"] * len(CHALLENGES)
    assert sum("frontier ← yours" in line for line in lines) == 1  # over all challenges


def test_missing_challenges_are_named(roots: tuple[Path, Path]) -> None:
    (text,) = missing_challenges(result_set(load(roots[0]), "mine"), ["frontier"])
    assert text == (
        "frontier: stump_tracks original, stump_tracks forgetting_student, stump_tracks diverse_students, "
        "parkour original"
    )


def test_the_page_has_all_of_it(roots: tuple[Path, Path], tmp_path: Path, told: Told) -> None:
    mine, theirs = Path(shutil.copytree(roots[0], tmp_path / "mine")), roots[1]
    said = told(0, "compare", mine, "--baseline", theirs, "--baseline", "paper-2021")
    apart, verdict, in_the_end, place = said.splitlines()
    assert apart.startswith("Nothing of paper-2021 may be compared with yours: its tables are of Box2D")
    assert verdict == (
        "Over 3 challenges (expert knowledge none, 2 million steps) frontier ranks 1 of 3 by mean (sooner), "
        "and the tests leave 1 to 2 open: better than 1 (Random); "
        "undecided against 1 (RIAC) (p < 0.05 after Holm for all pairs of the core; few seeds)."
    )
    assert "frontier ranks 1 of 3 by mean (in the end)" in in_the_end
    index = Path(place)
    text = re.sub(r"\s+", " ", unpacked(index.read_text()))
    assert f"<p><b>{verdict.replace('<', '&lt;')}</b></p>" in text
    assert "frontier is better than Random on 2 of 3 challenges" in text
    assert "Set beside: paper-2021" in text
    assert "Set beside: lite" in text
    assert "engine Box2D; 20 million steps" in text
    assert "<h3>Challenges without results</h3> <p>frontier: stump_tracks original" in text
    assert "Over all challenges" in text
    place = "expert knowledge none, 2 million steps"
    assert f'</span>frontier ← yours</th> <td data-label="At" class="verdict">{place}</td>' in text
    assert text.count('class="own"') == 3 + 1
    assert '"name":"frontier \\u2190 yours"' in text
    assert "Challenges of Stump Tracks, expert knowledge none" in text
    assert '<th scope="row">frontier</th> <td data-label="Mostly unfeasible"><b>75.0 ± 5.8</b></td>' in text
    assert {path.name for path in index.parent.glob("*.png")} >= {"radar-paper-2021.png"}
    assert addresses_in(text) == set()
    assert index.parents[1] == mine / "compare"
    assert index.parent.name.endswith("lite+paper-2021")  # so that none replaces that of other baselines
    assert "--baseline" in told(2, "compare", mine)


@pytest.mark.slow
def test_a_root_without_results_gives_a_page_that_says_so(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path)
    index = write_comparison(tmp_path, ["paper-2021"], tmp_path / "page")
    assert index == tmp_path / "page" / "paper-2021" / "index.html"
    page = index.read_text()
    assert "This root holds no runs yet." in page
    assert "No result of yours may be compared" in page


@pytest.mark.slow
def test_the_area_under_the_curve_can_be_the_measure(tmp_path: Path, told: Told) -> None:
    """Random ends as high as the new teacher, which was there from the start."""
    mine, theirs = tmp_path / "mine", tmp_path / "theirs"
    for root, teacher, first in ((mine, "frontier", 8), (theirs, "random", 0)):
        campaign = SyntheticCampaign(root, experiment=CHALLENGES[0], steps=1_000)
        for seed, last in enumerate((7, 8, 9)):
            returns = {0: mastering(first), 1_000: mastering(last)}
            campaign.plain_run(teacher, seed, returns, level="none", challenge=CHALLENGES[0])
    runs = comparable_runs(result_set(load(mine), "yours"), [result_set(load(theirs), "theirs")])
    ends, areas = (head_to_head(runs, ["frontier"], f"mastered_{of}") for of in ("percent", "area"))
    assert ends["difference"].tolist() == [0.0]
    assert areas["difference"].tolist() == [40.0]
    said = told(0, "compare", mine, "--baseline", theirs, "--measure", "mastered_area")
    rank, _, place = said.splitlines()
    assert "frontier ranks 1 of 2 by mean (sooner), as the tests confirm" in rank
    text = Path(place).read_text()
    assert "Mastered test tasks over training (%), mean" in text
    assert "80.0 ± 5.0" in text
