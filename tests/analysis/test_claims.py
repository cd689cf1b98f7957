"""The paper's claims hold in the paper's own tables, and beside a root's results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from synthetic_results import SyntheticCampaign
from views import printed

from analysis.claims.judging import PaperSource, RootSource, Verdict, judge
from analysis.commands.rankings import show_claims, show_search
from analysis.data.frames import load
from analysis.formatting import number
from analysis.measures.evaluations import search_results
from analysis.pages.report import write_report
from analysis.statistics.samples import Standing
from tma_ray.benchmark import MATRICES, PPO_GRID, TEACHER_GRIDS, TEACHERS, challenges_of, find_challenge
from tma_ray.benchmark.claims import CLAIMS, Bounded, Claim, Compared, Ranked, Reading, Relation, Scaled
from tma_ray.tasks import KnowledgeLevel

LOW, HIGH = KnowledgeLevel.LOW, KnowledgeLevel.HIGH

IN_THE_PAPER = {
    "knowledge_free_teachers": (Standing.UNDECIDED, "4 of 10"),
    "adr_needs_an_easy_start": (Standing.REFUTED, "0 of 5"),
    "goal_gan_needs_an_easy_start": (Standing.UNDECIDED, "4 of 5"),
    "adr_among_the_best": (Standing.SUPPORTED, "3 of 5"),
    "goal_gan_among_the_best": (Standing.SUPPORTED, "3 of 5"),
    "rugged_difficulty_stops_adr": (Standing.SUPPORTED, "2 of 2"),
    "goal_gan_does_not_recover": (Standing.UNDECIDED, "1 of 2"),
    "spdl_is_poor": (Standing.SUPPORTED, "11 of 15"),
    "easy_start_helps_adr": (Standing.SUPPORTED, "2 of 2"),
    "early_lead_where_most_is_unfeasible": (Standing.NO_DATA, "0 of 2"),
    "easy_start_is_fast": (Standing.NO_DATA, "0 of 8"),
    "goal_gan_leads_early": (Standing.NO_DATA, "0 of 5"),
    "parkour_needs_no_expert": (Standing.UNDECIDED, "0 of 3"),
    "parkour_alp_gmm_alone": (Standing.UNDECIDED, "3 of 10"),
    "parkour_setter_solver_ends_with_alp_gmm": (Standing.REFUTED, "0 of 1"),
    "parkour_stops_adr": (Standing.SUPPORTED, "1 of 1"),
    "parkour_spdl_and_setter_solver": (Standing.UNDECIDED, "0 of 2"),
    "parkour_goal_gan": (Standing.UNDECIDED, "0 of 2"),
    "nobody_climbs": (Standing.UNDECIDED, "0 of 8"),
    "parkour_is_open": (Standing.UNDECIDED, "13 of 16"),
    "easy_space_teaches_climbing": (Standing.NO_DATA, "0 of 2"),
}
"""Standing of each claim beside the paper's own tables, and the statements that these support.

What has no data is read after a part of the training, or comes from a case study without a table.
"""


def readings(claim: Claim) -> list[Reading]:
    found = []
    for statement in claim.statements:
        if isinstance(statement, Compared | Scaled):
            found += [statement.first, statement.second]
        else:
            found.append(statement.reading)
    return found


@pytest.mark.parametrize("verdict", judge(PaperSource()), ids=lambda verdict: verdict.claim.name)
def test_the_papers_claims_beside_the_papers_own_tables(verdict: Verdict) -> None:
    standing, supported = IN_THE_PAPER[verdict.claim.name]
    assert verdict.standing is standing
    assert verdict.describe().startswith(f"{supported} statements supported")


def test_a_sentence_that_its_own_tables_refute_is_shown_as_refuted() -> None:
    (adr,) = (verdict for verdict in judge(PaperSource()) if verdict.claim.name == "adr_needs_an_easy_start")
    refuted = [finding for finding in adr.findings if finding.standing is Standing.REFUTED]
    assert ["p = 0.007" in finding.evidence for finding in refuted] == [True, False, False]
    assert all("p\N{NO-BREAK SPACE}< 0.001" in finding.evidence for finding in refuted[1:])


def test_spdl_is_worse_than_random_in_11_of_15_of_which_one_is_doubtful() -> None:
    (spdl,) = (verdict for verdict in judge(PaperSource()) if verdict.claim.name == "spdl_is_poor")
    assert "11 claimed, one of the 11 rests on" in spdl.describe()
    assert spdl.describe().endswith("10 without it")


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_claims_are_about_what_the_benchmark_runs(claim: Claim) -> None:
    assert 0 < claim.needed <= len(claim.statements)
    for reading in readings(claim):
        assert reading.teacher in TEACHERS
        find_challenge(reading.environment, reading.challenge)
        bodies = {b for m in MATRICES if m.environment == reading.environment for b in m.embodiments}
        assert not reading.embodiment or reading.embodiment in bodies


def write(root: Path, teacher: str, mastered: list[int], **changes: object) -> None:
    """Write finished runs that master so many of ten test tasks in the end, and half of them before."""
    fields = {"challenge": "rugged_difficulty", "test_set": "stump_tracks"} | changes
    SyntheticCampaign(root, experiment="claims").seeds(teacher, mastered, half=0.5, **fields)


@pytest.fixture
def rugged(tmp_path: Path) -> Path:
    """A root in which ADR is worse than Random on the rugged challenge."""
    write(tmp_path, "random", [5, 6, 4, 5])
    write(tmp_path, "adr", [1, 2, 1, 2])
    return tmp_path


def standing(root: Path, *statements: object) -> list[Standing]:
    claims = [Claim("one", "one statement", "here", (statement,)) for statement in statements]  # type: ignore[arg-type]
    return [verdict.standing for verdict in judge(RootSource(load(root)), claims)]


def test_statements_are_judged_by_the_runs_of_a_root(tmp_path: Path) -> None:
    write(tmp_path, "random", [5, 6, 4, 5], level="none")
    write(tmp_path, "adr", [1, 2, 1, 2])
    write(tmp_path, "sfl", [9, 9, 9, 9])  # no teacher of the paper, so that it has no rank there
    adr, random = (Reading(teacher, "rugged_difficulty", LOW) for teacher in ("adr", "random"))
    early = Reading("adr", "rugged_difficulty", LOW, share=0.5)
    expected = {
        Compared(adr, Relation.WORSE, random): Standing.SUPPORTED,
        Compared(adr, Relation.BETTER, random): Standing.REFUTED,
        Compared(adr, Relation.NOT_BETTER, random): Standing.SUPPORTED,
        Compared(adr, Relation.ALIKE, random): Standing.REFUTED,
        Compared(random, Relation.LOWER, adr): Standing.REFUTED,
        Compared(random, Relation.ALIKE, random): Standing.UNDECIDED,  # the same runs
        Bounded(adr, most=30.0): Standing.SUPPORTED,
        Bounded(adr, most=20.0): Standing.UNDECIDED,  # the mean is 15, and its interval 6 to 24
        Bounded(adr, least=30.0): Standing.REFUTED,
        Bounded(adr, least=20.0, best_seed=True): Standing.SUPPORTED,
        Ranked(random, 1): Standing.SUPPORTED,
        Ranked(adr, 1): Standing.REFUTED,
        Ranked(adr, 2): Standing.NO_DATA,  # two of two says nothing
        Scaled(adr, 0.2, early): Standing.SUPPORTED,
        Scaled(adr, 3.0, early): Standing.UNDECIDED,
        Scaled(early, 3.0, adr): Standing.REFUTED,
    }
    assert dict(zip(expected, standing(tmp_path, *expected), strict=True)) == expected


def test_half_a_pool_decides_nothing(tmp_path: Path) -> None:
    parkour = {"environment": "parkour", "challenge": "original"}
    sets = challenges_of("parkour")["original"]
    for body, kind in (("classic_bipedal", "walker"), ("fish", "swimmer")):
        tests = {"embodiment": body, "test_set": sets.test_set_of(kind)}
        for place, teacher in enumerate(("random", "adr")):
            write(tmp_path / body, teacher, [3 + place] * 4 + [5], **parkour, **tests)
    reading = Reading("adr", "original", LOW, "parkour", "fish")
    assert standing(tmp_path / "fish", Bounded(reading, most=50.0)) == [Standing.SUPPORTED]
    everywhere = Reading("adr", "original", LOW, "parkour")
    assert standing(tmp_path / "fish", Bounded(everywhere, most=50.0)) == [Standing.NO_DATA]


def test_claims_need_as_many_as_they_say(tmp_path: Path) -> None:
    write(tmp_path, "adr", [1, 2, 1, 2])
    adr, spdl = (Reading(teacher, "rugged_difficulty", LOW) for teacher in ("adr", "spdl"))
    yes, no, unknown = Bounded(adr, most=50.0), Bounded(adr, least=50.0), Bounded(spdl, most=50.0)
    source = RootSource(load(tmp_path))

    def decide(at_least: int, *statements: Bounded) -> Standing:
        return judge(source, [Claim("some", "some of these", "here", statements, at_least)])[0].standing

    assert decide(1, yes, no, unknown) is Standing.SUPPORTED
    assert decide(2, yes, no, unknown) is Standing.UNDECIDED
    assert decide(1, unknown) is Standing.NO_DATA
    assert decide(3, yes, no, unknown) is Standing.REFUTED


def test_an_empty_root_decides_no_claim(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path)
    assert {verdict.standing for verdict in judge(RootSource(load(tmp_path)))} == {Standing.NO_DATA}


def test_claims_are_shown_with_what_is_behind_them(rugged: Path) -> None:
    text = printed(show_claims, rugged, details=True)
    assert "undecided: In a rugged landscape ADR is worse than Random, whatever it knows." in text
    assert "1 of 2 statements supported, 1 no data" in text
    assert (
        f"supported: ADR (rugged difficulty, low) {number(-35)} points from Random (rugged difficulty, low)"
        in text
    )


def test_the_report_tells_which_claims_it_can_judge(rugged: Path) -> None:
    page = write_report(rugged).read_text()
    assert "In a rugged landscape ADR is worse than Random" in page
    assert "No teacher masters more than 1 % with the chimpanzee" not in page


def searched(root: Path, side: str, name: str, counts: dict[int, list[int]]) -> None:
    """Write a seed for each count of two mastered tasks at the points of a grid."""
    grid = {**TEACHER_GRIDS, "ppo": PPO_GRID}[name]
    names = {"teacher": "random", "student": "sac"} | {side: name}
    for place, values in counts.items():
        spec = json.dumps({f"{side}_hyperparameters": grid.points()[place] | {"other": 1}})
        campaign = SyntheticCampaign(root, experiment=f"search_{name}_{place:02}")
        campaign.seeds(names["teacher"], values, 2, level="none", student=names["student"], spec=spec)


def test_points_are_ranked_by_mean_mastered_tasks_and_the_papers_choice_is_marked(tmp_path: Path) -> None:
    searched(tmp_path, "teacher", "alp_gmm", {0: [1, 2], 1: [1, 1], 2: [2, 2]})
    found = search_results(load(tmp_path))
    assert found["mean"].tolist() == [100.0, 75.0, 50.0]
    assert found["chosen"].tolist() == [False, True, False]
    assert found["n"].tolist() == [2, 2, 2]
    assert found["point"].tolist() == [TEACHER_GRIDS["alp_gmm"].points()[place] for place in (2, 0, 1)]


def test_the_best_is_shown_beside_the_papers_choice(tmp_path: Path) -> None:
    searched(tmp_path, "teacher", "alp_gmm", {0: [1, 2], 2: [2, 2]})
    searched(tmp_path, "student", "ppo", {5: [2, 2]})
    lines = printed(show_search, tmp_path, width=300).splitlines()
    (teacher,) = (line for line in lines if "ALP-GMM" in line)
    assert "fit_every 50, most_components 5, explore 0.1" in teacher
    assert "fit_every 150, most_components 10, explore 0.05" in teacher
    assert "75.0 ± 35.4" in teacher
    assert "p = 1.000" in teacher
    (student,) = (line for line in lines if line.startswith("PPO"))
    assert "not run yet" in student


def test_a_root_without_a_search_says_so(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path).plain_run("random", 0, {0: [1.0]}, status="running")
    assert "No point of a search" in printed(show_search, tmp_path)
