"""The paper's claims hold in the paper's own tables, and beside a root's results."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from synthetic_results import SyntheticCampaign, mastering
from views import printed

from analysis.claims.agreement import BOOTSTRAP_DRAWS, draws_of_entries, draws_of_runs, kendall, tau_interval
from analysis.claims.judging import ClaimVerdict, judge
from analysis.claims.sources import PaperSource, RootSource, Sample
from analysis.commands.claims import show_claims
from analysis.commands.rankings import show_search
from analysis.data.loading import load
from analysis.formatting import number
from analysis.measures.evaluations import search_results
from analysis.pages.report import write_report
from analysis.statistics import Description, describe, percent_interval
from analysis.statistics.samples import Standing, bounded_interval, contrary, equivalent, greater
from tma_ray.benchmark import (
    MATRICES,
    PAPER_STEPS,
    PPO_GRID,
    TEACHER_GRIDS,
    TEACHERS,
    challenges_of,
    find_challenge,
)
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
    pairs = [each for each in claim.statements if isinstance(each, Compared | Scaled)]
    single = [each.reading for each in claim.statements if each not in pairs]
    return single + [reading for pair in pairs for reading in (pair.first, pair.second)]


@pytest.mark.parametrize("verdict", judge(PaperSource()), ids=lambda verdict: verdict.claim.name)
def test_the_papers_claims_beside_the_papers_own_tables(verdict: ClaimVerdict) -> None:
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
    fields: dict[str, Any] = {"challenge": "rugged_difficulty", "test_set": "stump_tracks"} | changes
    steps = fields.pop("steps", PAPER_STEPS)
    SyntheticCampaign(root, steps=steps, experiment="claims").seeds(teacher, mastered, half=0.5, **fields)


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


def test_an_empty_root_and_other_teachers_decide_no_claim(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path)
    for seeds in ([], [5, 6, 4, 5]):
        write(tmp_path, "sfl", seeds)
        assert {verdict.standing for verdict in judge(RootSource(load(tmp_path)))} == {Standing.NO_DATA}


def test_claims_are_shown_with_what_is_behind_them(rugged: Path) -> None:
    text = " ".join(printed(show_claims, rugged, details=True).split())
    assert "undecided: In a rugged landscape ADR is worse than Random, whatever it knows." in text
    assert "1 of 2 statements supported, 1 no data" in text
    difference = f"ADR (rugged difficulty, low) {number(-35)} points from Random (rugged difficulty, low)"
    assert f"supported: {difference}" in text


def test_the_report_tells_which_claims_it_can_judge(rugged: Path) -> None:
    page = write_report(rugged).read_text()
    assert "In a rugged landscape ADR is worse than Random" in page
    assert "No teacher masters more than 1 % with the chimpanzee" not in page


def test_what_other_conditions_rule_out_is_not_seen_and_not_refuted(tmp_path: Path) -> None:
    """Half of the paper's budget, or other students, refute nothing that is about the paper's."""
    adr, random = (Reading(teacher, "rugged_difficulty", LOW) for teacher in ("adr", "random"))
    claim = Claim("one", "one statement", "here", (Compared(adr, Relation.BETTER, random),))
    found = {}
    for name, changes in {
        "paper": {},
        "short": {"steps": PAPER_STEPS // 2},
        "others": {"student": "ppo:preset=decisive"},
    }.items():
        write(tmp_path / name, "random", [5, 6, 4, 5], **changes)
        write(tmp_path / name, "adr", [1, 2, 1, 2], **changes)
        (verdict,) = judge(RootSource(load(tmp_path / name)), [claim])
        assert verdict.findings[0].standing is verdict.standing
        found[name] = verdict.standing_text
    assert found == {
        "paper": "refuted",
        "short": "not seen here (10 million steps of SAC)",
        "others": "not seen here (20 million steps of PPO)",
    }


def test_a_body_that_few_teachers_have_is_judged_alone(tmp_path: Path) -> None:
    """The pool of the other bodies is complete without it, and claims about it use its own runs."""
    sets = challenges_of("parkour")["original"]
    bodies = {"classic_bipedal": "walker", "fish": "swimmer", "climbing_chimpanzee": "climber"}
    for body, kind in bodies.items():
        tests = {"embodiment": body, "test_set": sets.test_set_of(kind), "student": "ppo"}
        campaign = SyntheticCampaign(tmp_path, steps=PAPER_STEPS, experiment=body)
        for place, teacher in enumerate(("random", "adr", "riac", "alp_gmm", "covar_gmm")):
            if kind != "climber" or place < 2:
                campaign.seeds(teacher, [3 + place, 4 + place], **PARKOUR | tests)
    source = RootSource(load(tmp_path))
    everywhere, climber = (Reading("adr", "original", LOW, "parkour", body) for body in ("", [*bodies][-1]))
    samples = {reading: source.sample(reading) for reading in (everywhere, climber)}
    assert {name for sample in samples.values() if sample for name in sample.strata} == {
        f"{body}/ppo" for body in bodies
    }
    assert source.teachers(climber) == ["adr", "random"]
    assert len(source.teachers(everywhere)) == 5
    assert source.note.endswith("of classic_bipedal, fish alone; apart stand those of climbing_chimpanzee.")


def test_a_teacher_with_the_settings_of_the_release_is_judged_for_lack_of_its_own(tmp_path: Path) -> None:
    spdl = Reading("spdl", "rugged_difficulty", LOW)
    write(tmp_path, "random", [5, 6, 4, 5])
    write(tmp_path, "spdl:preset=release", [1, 2, 1, 2])
    statement = Bounded(spdl, most=30.0)
    assert standing(tmp_path, statement) == [Standing.SUPPORTED]
    assert RootSource(load(tmp_path)).note == ("Without runs of SPDL, those of SPDL (release) are judged.")
    write(tmp_path, "spdl", [9, 9, 8, 9])
    assert standing(tmp_path, statement) == [Standing.REFUTED]
    assert RootSource(load(tmp_path)).note == ""


PARKOUR = {"environment": "parkour", "challenge": "original", "test_set": "parkour_walking"}


def walker(root: Path, teacher: str, mastered: list[int], **changes: Any) -> None:
    write(root, teacher, mastered, embodiment="classic_bipedal", **PARKOUR, **changes)


def test_equal_runs_have_an_interval(tmp_path: Path) -> None:
    """By the spread of the teachers there, as on boards; where none has any, by what is possible at all."""
    reading = Reading("random", "original", LOW, "parkour", "classic_bipedal")
    walker(tmp_path / "alone", "random", [0, 0, 0])
    alone = RootSource(load(tmp_path / "alone")).sample(reading)
    assert alone is not None
    assert alone.interval() == pytest.approx((0.0, 100 * (1 - 0.05 ** (1 / 3))))
    walker(tmp_path / "all", "random", [0, 0, 0])
    walker(tmp_path / "all", "adr", [0, 2, 1])
    found = RootSource(load(tmp_path / "all")).sample(reading)
    assert found is not None
    least = 0.5 * (0.0 + 100.0) / 2  # deviations of 0 and 10 points
    assert found.interval() == pytest.approx((0.0, stats.t.ppf(0.975, 2) * np.sqrt(least / 3)))
    assert standing(tmp_path / "all", Bounded(reading, most=60.0)) == [Standing.SUPPORTED]


def test_the_exact_interval_of_equal_runs_holds() -> None:
    """Each run is 100 with a probability that shows no such run in just 5 % of samples of 5, and else 0."""
    rng, chance = np.random.default_rng(3), 1 - 0.05 ** (1 / 5)
    empty = rng.binomial(5, chance, 20_000) == 0
    assert empty.mean() == pytest.approx(0.05, abs=0.005)
    assert bounded_interval(0.0, 5) == pytest.approx((0.0, 100 * chance))
    assert bounded_interval(40.0, 5) == pytest.approx((40 * (1 - chance), 40 * (1 - chance) + 100 * chance))


def test_an_interval_over_strata_is_that_of_the_stratified_mean() -> None:
    strata = {"a": pd.Series([10.0, 14.0, 9.0]), "b": pd.Series([30.0, 35.0, 45.0, 30.0])}
    variances, sizes = [each.var() for each in strata.values()], [3, 4]
    parts = np.array([variance / n / 4 for variance, n in zip(variances, sizes, strict=True)])
    freedom = parts.sum() ** 2 / (parts**2 / (np.array(sizes) - 1)).sum()
    mean = (11.0 + 35.0) / 2
    margin = stats.t.ppf(0.975, freedom) * np.sqrt(parts.sum())
    sample = Sample(Description(7, mean, 1.0), strata)
    assert sample.interval() == pytest.approx(percent_interval(mean, margin))


def test_bodies_are_strata_of_tests(tmp_path: Path) -> None:
    """Means of 5 and 55 points of two bodies are no spread of teachers that differ by 10 on each."""
    for body in ("spider", "short_bipedal"):
        low = 0 if body == "spider" else 5
        for teacher, more in (("random", 0), ("adr", 1)):
            changes = {"challenge": "diverse_students", "embodiment": body, "student": "ppo:preset=decisive"}
            counts = [low + more, low + more, low + more + 1, low + more + 1]
            SyntheticCampaign(tmp_path, steps=PAPER_STEPS, experiment=body).seeds(teacher, counts, **changes)
    first, second = (Reading(teacher, "diverse_students", LOW) for teacher in ("adr", "random"))
    source = RootSource(load(tmp_path))
    samples = [source.sample(reading) for reading in (first, second)]
    assert samples[0] is not None
    assert samples[1] is not None
    test = samples[0].test(samples[1])
    error = np.sqrt(4 * (np.var([0, 0, 10, 10], ddof=1) / 4) / 4)
    assert test.difference == pytest.approx(10.0)
    assert test.high - test.difference == pytest.approx(stats.t.ppf(0.975, 12) * error)
    assert standing(tmp_path, Compared(first, Relation.BETTER, second)) == [Standing.SUPPORTED]


def test_levels_of_the_same_runs_are_one_statement(tmp_path: Path) -> None:
    """SPDL has the same runs at levels none and low, and others at high."""
    campaign = SyntheticCampaign(tmp_path, steps=PAPER_STEPS, experiment="spdl")
    rugged = {"challenge": "rugged_difficulty"}
    for teacher, mastered in (("random", [5, 6, 4]), ("spdl", [1, 2, 1])):
        for seed, count in enumerate(mastered):
            campaign.plain_run(teacher, seed, {PAPER_STEPS: mastering(count)}, level="none", **rugged)
            campaign.cell(campaign.record(teacher, seed, "none", **rugged), "low")
    campaign.seeds("spdl", [2, 1, 1], level="high", **rugged)
    pairs = [
        Compared(
            Reading("spdl", "rugged_difficulty", level),
            Relation.WORSE,
            Reading("random", "rugged_difficulty", level),
        )
        for level in KnowledgeLevel
    ]
    (verdict,) = judge(RootSource(load(tmp_path)), [Claim("spdl", "worse", "here", tuple(pairs), at_least=2)])
    assert len(verdict.findings) == 2
    assert verdict.needed == 2  # of two, as two thirds of two are more than one
    assert "SPDL (rugged difficulty, none and low)" in verdict.findings[0].evidence
    assert "SPDL (rugged difficulty, high)" in verdict.findings[1].evidence
    assert "of 3 in the paper, some of which are the same runs here" in verdict.describe()


def test_a_rank_among_too_few_teachers_is_said_so(rugged: Path) -> None:
    claim = Claim("one", "one", "here", (Ranked(Reading("adr", "rugged_difficulty", LOW), 3),))
    (verdict,) = judge(RootSource(load(rugged)), [claim])
    assert verdict.findings[0].standing is Standing.NO_DATA
    assert "complete results of 1 other teacher of the paper, too few" in verdict.findings[0].evidence


def test_definitions_are_told_on_demand_and_the_table_comes_first(rugged: Path) -> None:
    text = printed(show_claims, rugged)
    assert text.startswith("standing")
    assert "excludes its contrary" not in text
    assert max(map(len, text.splitlines())) <= 100
    assert "is supported where a 95 % interval" in printed(show_claims, rugged, explain=True)


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


def test_tau_is_that_of_scipy_with_ties_too() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.integers(0, 5, (2, 20, 8)).astype(float)
    expected = [stats.kendalltau(*each).statistic for each in zip(first, second, strict=True)]
    assert kendall(first, second) == pytest.approx(expected)
    assert np.isnan(kendall(np.zeros(4), np.arange(4.0)))


def test_draws_scatter_as_means_of_runs_do() -> None:
    """Of two strata of equal weight, by the variance of their runs with n - 1."""
    rng = np.random.default_rng(2)
    strata = [pd.Series([1.0, 4.0, 10.0]), pd.Series([0.0, 20.0])]
    drawn = draws_of_runs(strata, rng)
    assert drawn.shape == (BOOTSTRAP_DRAWS,)
    assert drawn.mean() == pytest.approx(7.5, abs=0.4)
    assert drawn.var() == pytest.approx((21.0 / 3 + 200.0 / 2) / 4, rel=0.1)
    assert np.isnan(draws_of_runs([pd.Series([1.0])], rng)).all()
    entries = [Description(16, 10.0, 8.0), Description(16, 20.0, 8.0)]
    assert draws_of_entries(entries, rng).mean() == pytest.approx(15.0, abs=0.1)
    assert draws_of_entries(entries, rng).std() == pytest.approx(np.sqrt(8.0) / 2, rel=0.05)


@pytest.mark.parametrize("agreeing", [0.0, 0.7])
def test_the_interval_holds_the_tau_that_other_runs_have(agreeing: float) -> None:
    """Eight teachers on six challenges, 5 and 32 seeds; true effects as large as the deviation of a run."""
    rng = np.random.default_rng(7)
    mine = rng.normal(0.0, 9.0, (6, 8))
    theirs = agreeing * mine + np.sqrt(1 - agreeing**2) * rng.normal(0.0, 9.0, (6, 8))

    def sides() -> tuple[np.ndarray, np.ndarray]:
        return rng.normal(mine[..., None], 9.0, (6, 8, 5)), rng.normal(theirs[..., None], 9.0, (6, 8, 32))

    def tau(ours: np.ndarray, papers: np.ndarray) -> float:
        return float(kendall(ours.mean(axis=-1), papers.mean(axis=-1)).mean())

    expected, held = np.mean([tau(*sides()) for _ in range(400)]), []
    for _ in range(60):
        ours, papers = sides()
        draws = [
            kendall(
                np.stack([draws_of_runs([pd.Series(runs)], rng) for runs in place], axis=-1),
                np.stack([draws_of_entries([describe(runs)], rng) for runs in other], axis=-1),
            )
            for place, other in zip(ours, papers, strict=True)
        ]
        low, high = tau_interval(tau(ours, papers), np.mean(draws, axis=0))
        assert high - low < 0.5
        held.append(low <= expected <= high)
    assert np.mean(held) > 0.88


@pytest.mark.parametrize(
    ("low", "high", "is_greater", "is_equivalent"),
    [
        (1.0, 20.0, Standing.SUPPORTED, Standing.REFUTED),
        (-20.0, -1.0, Standing.REFUTED, Standing.REFUTED),
        (-2.0, 3.0, Standing.REFUTED, Standing.SUPPORTED),
        (0.5, 3.0, Standing.SUPPORTED, Standing.SUPPORTED),
        (-8.0, 12.0, Standing.UNDECIDED, Standing.UNDECIDED),
        (-8.0, 4.0, Standing.REFUTED, Standing.UNDECIDED),
        (math.nan, math.nan, Standing.UNDECIDED, Standing.UNDECIDED),
    ],
)
def test_standings(low: float, high: float, is_greater: Standing, is_equivalent: Standing) -> None:
    assert greater(low, high) is is_greater
    assert equivalent(low, high) is is_equivalent
    assert equivalent(-high, -low) is is_equivalent
    assert contrary(contrary(greater(low, high))) is greater(low, high)


def intervals(difference: float, seeds: int, experiments: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    first, second = rng.normal(difference, 10, (experiments, seeds)), rng.normal(0, 10, (experiments, seeds))
    found = stats.ttest_ind(first, second, axis=1, equal_var=False).confidence_interval(0.95)
    return np.column_stack([found.low, found.high])


@pytest.mark.parametrize("seeds", [3, 32])
def test_a_teacher_that_is_better_is_not_called_no_better_for_lack_of_seeds(seeds: int) -> None:
    # A difference of 10 points, a deviation of 10: few seeds leave it undecided, and do not refute it.
    standings = [greater(low, high) for low, high in intervals(10.0, seeds, 1_000)]
    assert standings.count(Standing.REFUTED) <= 0.025 * len(standings) + 10
    assert (standings.count(Standing.UNDECIDED) > 700) is (seeds == 3)


def test_equivalence_is_seldom_found_where_there_is_none() -> None:
    standings = [equivalent(low, high) for low, high in intervals(5.0, 32, 1_000)]
    assert standings.count(Standing.SUPPORTED) <= 0.025 * len(standings) + 10
    alike = [equivalent(low, high) for low, high in intervals(0.0, 200, 1_000)]
    assert alike.count(Standing.SUPPORTED) > 900
