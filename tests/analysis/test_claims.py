"""The paper's claims hold in the paper's own tables, and are judged by what a root holds."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console
from synthetic_results import SyntheticCampaign

from analysis.claim_sources import PaperSource, RootSource
from analysis.claims import Standing, Verdict, judge
from analysis.claims_view import show_claims
from analysis.formatting import number
from analysis.frames import load
from analysis.report import write_report
from tma_ray.benchmark import MATRICES, TEACHERS, challenges_of, find_challenge
from tma_ray.benchmark.claims import CLAIMS
from tma_ray.benchmark.statements import Bounded, Claim, Compared, Ranked, Reading, Relation, Scaled
from tma_ray.tasks import KnowledgeLevel

LOW, HIGH = KnowledgeLevel.LOW, KnowledgeLevel.HIGH

NOT_IN_ITS_TABLES = {
    "early_lead_where_most_is_unfeasible",
    "easy_start_is_fast",
    "goal_gan_leads_early",
    "easy_space_teaches_climbing",
}
"""Read after a quarter of the training, or from a case study that has no table."""


def readings(claim: Claim) -> list[Reading]:
    found = []
    for statement in claim.statements:
        if isinstance(statement, Compared | Scaled):
            found += [statement.first, statement.second]
        else:
            found.append(statement.reading)
    return found


@pytest.mark.parametrize("verdict", judge(PaperSource()), ids=lambda verdict: verdict.claim.name)
def test_the_papers_claims_hold_in_the_papers_own_tables(verdict: Verdict) -> None:
    open_ = verdict.claim.name in NOT_IN_ITS_TABLES
    assert verdict.standing is (Standing.OPEN if open_ else Standing.HOLDS)


def test_spdl_is_worse_than_random_in_exactly_11_of_15() -> None:
    (spdl,) = (verdict for verdict in judge(PaperSource()) if verdict.claim.name == "spdl_is_poor")
    assert spdl.describe() == "11 of 15 hold, 11 are claimed"


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.name)
def test_claims_are_about_what_the_benchmark_runs(claim: Claim) -> None:
    assert 0 < claim.needed <= len(claim.statements)
    for reading in readings(claim):
        assert reading.teacher in TEACHERS
        find_challenge(reading.environment, reading.challenge)
        bodies = {b for m in MATRICES if m.environment == reading.environment for b in m.embodiments}
        assert not reading.embodiment or reading.embodiment in bodies


def write(root: Path, teacher: str, mastered: list[int], **changes: object) -> None:
    """Writes finished runs that master so many of ten test tasks in the end, and half of them before."""
    level = str(changes.pop("level", "low"))
    fields = {"challenge": "rugged_difficulty", "test_set": "stump_tracks"} | changes
    campaign = SyntheticCampaign(root, experiment="claims")
    for seed, count in enumerate(mastered):
        returns = [300.0] * count + [0.0] * (10 - count)
        half = [300.0] * (count // 2) + [0.0] * (10 - count // 2)
        campaign.plain_run(
            teacher, seed, {campaign.steps // 2: half, campaign.steps: returns}, level=level, **fields
        )


def standing(root: Path, *statements: object) -> list[Standing]:
    claims = [Claim("one", "one statement", "here", (statement,)) for statement in statements]  # type: ignore[arg-type]
    return [verdict.standing for verdict in judge(RootSource(load(root)), claims)]


def test_statements_are_judged_by_the_runs_of_a_root(tmp_path: Path) -> None:
    write(tmp_path, "random", [5, 6, 4, 5], level="none")
    write(tmp_path, "adr", [1, 2, 1, 2])
    adr, random = (Reading(teacher, "rugged_difficulty", LOW) for teacher in ("adr", "random"))
    early = Reading("adr", "rugged_difficulty", LOW, share=0.5)
    assert standing(
        tmp_path,
        Compared(adr, Relation.WORSE, random),
        Compared(adr, Relation.BETTER, random),
        Compared(adr, Relation.NOT_BETTER, random),
        Compared(adr, Relation.ALIKE, random),
        Compared(random, Relation.LOWER, adr),
        Compared(random, Relation.ALIKE, random),
        Bounded(adr, most=15.0),
        Bounded(adr, least=20.0),
        Bounded(adr, least=20.0, best_seed=True),
        Ranked(random, 1),
        Ranked(adr, 2),
        Scaled(adr, 3.0, early),
        Scaled(early, 0.9, adr),
    ) == [
        Standing.HOLDS,
        Standing.FAILS,
        Standing.HOLDS,
        Standing.FAILS,
        Standing.FAILS,
        Standing.OPEN,  # the same runs
        Standing.HOLDS,
        Standing.FAILS,
        Standing.HOLDS,
        Standing.HOLDS,
        Standing.OPEN,  # two of two says nothing
        Standing.HOLDS,
        Standing.FAILS,
    ]


def test_half_a_pool_decides_nothing(tmp_path: Path) -> None:
    parkour = {"environment": "parkour", "challenge": "original"}
    sets = challenges_of("parkour")["original"]
    for body, kind in (("classic_bipedal", "walker"), ("fish", "swimmer")):
        tests = {"embodiment": body, "test_set": sets.test_set_of(kind)}
        for place, teacher in enumerate(("random", "adr")):
            write(tmp_path / body, teacher, [3 + place] * 2 + [5], **parkour, **tests)
    reading = Reading("adr", "original", LOW, "parkour", "fish")
    assert standing(tmp_path / "fish", Bounded(reading, most=50.0)) == [Standing.HOLDS]
    everywhere = Reading("adr", "original", LOW, "parkour")
    assert standing(tmp_path / "fish", Bounded(everywhere, most=50.0)) == [Standing.OPEN]


def test_claims_need_as_many_as_they_say(tmp_path: Path) -> None:
    write(tmp_path, "adr", [1, 2])
    adr, spdl = (Reading(teacher, "rugged_difficulty", LOW) for teacher in ("adr", "spdl"))
    yes, no, unknown = Bounded(adr, most=50.0), Bounded(adr, least=50.0), Bounded(spdl, most=50.0)
    source = RootSource(load(tmp_path))

    def decide(at_least: int, *statements: Bounded) -> Standing:
        return judge(source, [Claim("some", "some of these", "here", statements, at_least)])[0].standing

    assert decide(1, yes, no, unknown) is Standing.HOLDS
    assert decide(2, yes, no, unknown) is Standing.OPEN
    assert decide(3, yes, no, unknown) is Standing.FAILS


def test_an_empty_root_leaves_every_claim_open(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path)
    assert {verdict.standing for verdict in judge(RootSource(load(tmp_path)))} == {Standing.OPEN}


def test_claims_are_shown_with_what_is_behind_them(tmp_path: Path) -> None:
    write(tmp_path, "random", [5, 6, 4, 5])
    write(tmp_path, "adr", [1, 2, 1, 2])
    console = Console(width=200, record=True)
    show_claims(tmp_path, details=True, console=console)
    text = console.export_text()
    assert "not enough data: In a rugged landscape ADR is worse than Random, whatever it knows." in text
    assert "1 of 2 hold, 1 are open" in text
    assert (
        f"holds: ADR (rugged difficulty, low) {number(-35)} points from Random (rugged difficulty, low)"
        in text
    )


def test_the_report_tells_which_claims_it_can_judge(tmp_path: Path) -> None:
    write(tmp_path, "random", [5, 6, 4, 5])
    write(tmp_path, "adr", [1, 2, 1, 2])
    page = write_report(tmp_path, tmp_path / "report").read_text()
    assert "In a rugged landscape ADR is worse than Random" in page
    assert "No teacher masters more than 1 % with the chimpanzee" not in page
