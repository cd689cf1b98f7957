"""Leaderboards, findings and completeness of a release, on invented runs of known quality."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy import stats
from synthetic_results import SyntheticCampaign
from views import Told, printed

import analysis
from analysis.baselines import BaselineError, add_to_release, find_baseline, release
from analysis.baselines.catalogue import BASELINE_FILE, read
from analysis.baselines.verification import lacking
from analysis.charts.base import Curve
from analysis.charts.catalogue import trained_steps_chart
from analysis.charts.paper.drawing import draw
from analysis.charts.paper.style import svg
from analysis.claims.agreement import agreements
from analysis.commands.leaderboards import difference_charts, markdown, show_leaderboards
from analysis.commands.releases import findings
from analysis.comparisons.comparison import Measurements
from analysis.comparisons.leaderboards import leaderboards, notes
from analysis.comparisons.pairwise import over_challenges
from analysis.data.loading import load
from analysis.data.reference import paper_frame
from analysis.measures.pooling import runs_after
from analysis.measures.tested import FINAL, HEADLINE
from analysis.names import label
from analysis.statistics import percent_interval

CHALLENGES = ("mostly_unfeasible", "mostly_trivial")
TEACHERS = ("random", "adr", "alp_gmm", "riac")
STEPS = 2_000_000
NAMES = {"student": "ppo", "benchmark_version": 1}


def mean_of(teacher: str, challenge: str) -> float:
    """What the paper has for a teacher; of later ones what it has for Random."""
    teacher = teacher if teacher in TEACHERS else "random"
    paper = paper_frame()
    place = {"environment": "stump_tracks", "challenge": challenge, "expert_knowledge": "high"}
    place["teacher"] = teacher
    (mean,) = paper.loc[paper[list(place)].eq(place).all(axis=1), "mastered_percent_mean"]
    return float(mean)


def write(root: Path, seeds: dict[str, int], sign: int = 1, name: str = "core") -> Path:
    """Run whose means are those of the paper, or in the reverse order."""
    for challenge in CHALLENGES:
        campaign = SyntheticCampaign(root, experiment=challenge, campaign=name, steps=STEPS)
        for teacher, count in seeds.items():
            middle = round(50 + sign * (mean_of(teacher, challenge) - 25))
            counts = [middle + seed - count // 2 for seed in range(count)]
            campaign.seeds(teacher, counts, 100, level="high", challenge=challenge, **NAMES)
    return root


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("leaderboard") / "root", dict.fromkeys(TEACHERS, 3))


@pytest.fixture(scope="module")
def released(root: Path) -> Path:
    return add_to_release(root, "lite", "one", root.parent, "CC0-1.0")


def test_a_leaderboard_has_ranks_results_and_differences_to_random(released: Path) -> None:
    (board,) = leaderboards(load(released))
    assert board.title == "expert knowledge high, 2 million steps, Chipmunk 1"
    means = {name: np.mean([mean_of(name, challenge) for challenge in CHALLENGES]) for name in TEACHERS}
    assert [entry.teacher for entry in board.entries] == sorted(TEACHERS, key=lambda name: -means[name])
    for entry in board.entries:
        assert all(set(results) == set(board.columns) for results in entry.results.values())
        assert (entry.against is None) == (entry.teacher == "random")
        for mean, *ends in entry.results[HEADLINE].values():
            assert ends == pytest.approx(percent_interval(mean, stats.t.ppf(0.975, 2) / np.sqrt(3)))


@pytest.mark.slow
def test_steps_that_trained_stand_beside_those_that_were_spent() -> None:
    """ACCEL, robust PLR and SFL of lite-1 spend steps on scoring tasks, the core's teachers none."""
    core, everyone = leaderboards(analysis.load("lite-1"))
    assert all(entry.trained >= 95 for entry in core.entries)
    trained = {entry.teacher: entry.trained for entry in everyone.entries}
    fewer = {name: percent for name, percent in trained.items() if percent < 95}
    assert fewer == pytest.approx({"accel": 38, "robust_plr": 41, "sfl": 75}, abs=1)
    assert all(percent <= 100 for percent in trained.values())
    said = {entry.teacher: entry.against.verdict for entry in everyone.entries if entry.against}
    assert {name for name, verdict in said.items() if "per trained step" in verdict} == set(fewer)
    text = printed(show_leaderboards, ["lite-1"], width=100, subsets=True)
    assert re.search(r"ACCEL \*† ", text)
    assert max(map(len, text.splitlines())) <= 100


def test_a_body_that_few_teachers_have_has_a_leaderboard_of_its_own(tmp_path: Path) -> None:
    bodies = {"classic_bipedal": "walking", "fish": "swimming", "climbing_chimpanzee": "climbing"}
    for body, moving in bodies.items():
        place = {"environment": "parkour", "embodiment": body, "test_set": f"parkour_{moving}:every=2"}
        campaign = SyntheticCampaign(tmp_path, experiment=moving, steps=STEPS)
        for teacher in (*TEACHERS, "sfl")[: 2 if moving == "climbing" else 5]:
            campaign.seeds(teacher, [3, 4, 5], **place, **NAMES)
    both, climber = leaderboards(load(tmp_path))
    assert (len(both.entries), both.bodies) == (5, ("Classic bipedal", "Fish"))
    assert both.title == "expert knowledge low, 2 million steps, Chipmunk 1, classic_bipedal, fish"
    assert {rank.of for entry in both.entries for rank in entry.ranks.values()} == {5}
    assert (len(climber.entries), climber.bodies) == (2, ())
    assert climber.title == "expert knowledge low, 2 million steps, Chipmunk 1, climbing_chimpanzee"


def test_a_single_seed_shows_no_best_teacher(tmp_path: Path) -> None:
    """A cell without spread between seeds has one known exactly, one with a single seed does not."""
    (several,) = leaderboards(load(write(tmp_path / "two", dict.fromkeys(TEACHERS, 2))))
    assert sum(several.best(FINAL).values()) == pytest.approx(1.0, abs=0.05)
    (board,) = leaderboards(load(write(tmp_path / "one", dict.fromkeys(TEACHERS, 1))))
    assert board.best(FINAL) == {}
    assert board.answer().startswith("With a single seed in a cell no teacher can be called the best. ")
    gaps = {str(entry.against.gaps[FINAL])[-15:] for entry in board.entries if entry.against}
    assert gaps == {"[needs 2 seeds]"}


def test_curves_against_the_steps_that_trained_end_where_these_do() -> None:
    charts = {
        str(comparison.cells["challenge"].iloc[0]): chart
        for comparison in Measurements(analysis.load("lite-1")).comparisons
        for chart in trained_steps_chart(comparison)
    }
    assert set(charts) == {"mostly_unfeasible", "original", "rugged_difficulty"}
    marks = charts["original"].panels[0][0].marks
    ends = {mark.teacher: mark.x[-1] / 2e6 for mark in marks if isinstance(mark, Curve)}
    assert ends["accel"] == pytest.approx(0.39, abs=0.01)
    assert ends["alp_gmm"] == pytest.approx(1.0, abs=0.002)


def test_teachers_are_ranked_on_the_same_challenges_only(root: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(root, tmp_path / "root"))
    one = SyntheticCampaign(root, experiment=CHALLENGES[0], campaign="others", steps=STEPS)
    one.seeds("sfl", [100] * 3, 100, level="high", challenge=CHALLENGES[0], **NAMES)
    whole, part = leaderboards(load(root))
    assert {entry.teacher for entry in whole.entries} == set(TEACHERS)
    assert {rank.of for entry in whole.entries for rank in entry.ranks.values()} == {4}
    assert part.title.endswith(": the 5 teachers on 1 of 2 challenges")
    assert [entry.ranks[FINAL].rank for entry in part.entries] == [1, 2, 3, 4, 5]
    assert {rank.of for entry in part.entries for rank in entry.ranks.values()} == {5}
    assert part.entries[0].teacher == "sfl"
    assert all(set(entry.results[FINAL]) == set(part.challenges) for entry in part.entries)


def test_boards_have_titles_of_their_own(tmp_path: Path) -> None:
    """Parkour's bodies are one challenge, although the test sets of their types are three, thinned alike."""
    parkour = {"classic_bipedal": "walking", "fish": "swimming", "climbing_chimpanzee": "climbing"}
    cells = [
        {"environment": "parkour", "embodiment": body, "student": "ppo", "test_set": f"parkour_{way}:every=2"}
        for body, way in parkour.items()
    ]
    cells += [{"challenge": CHALLENGES[0], "student": student} for student in ("ppo", "sac")]
    for number, cell in enumerate(cells):
        runs = SyntheticCampaign(tmp_path / "root", campaign="several", prefix=f"{number}-", steps=STEPS)
        for teacher in ("random", "alp_gmm"):
            runs.seeds(teacher, [10, 30], 100, **cell)
    boards = leaderboards(load(tmp_path / "root"))
    (of_parkour,) = (board for board in boards if board.bodies)
    assert of_parkour.columns == ("Parkour", "Classic bipedal", "Climbing chimpanzee", "Fish")
    assert set(of_parkour.entries[0].results[FINAL]) == set(of_parkour.columns)
    assert {title for _, title in of_parkour.on_each_challenge(FINAL)} == set(of_parkour.columns)
    start = "expert knowledge low, 2 million steps, Chipmunk 1"
    found = {board.title: (len(board.challenges), board.entries[0].ranks[FINAL].n) for board in boards}
    titles = (f"Parkour, {start}", f"Stump Tracks, {start}", f"Stump Tracks, {start}, ppo")
    assert found == dict(zip(titles, ((1, 6), (1, 2), (1, 2)), strict=True))


def test_the_same_is_shown_in_the_terminal_and_on_the_site(released: Path, told: Told) -> None:
    text = printed(show_leaderboards, [str(released)], width=100, challenges=True, explain=True)
    assert max(map(len, text.splitlines())) <= 100
    page = markdown(str(released))
    (board,) = leaderboards(load(released))
    low, high = board.entries[0].results[HEADLINE][board.challenges[0]][1:]
    assert f"[{low:.0f},{high:.0f}]" in text
    assert f"[{low:.0f}, {high:.0f}]" in page
    assert "±" not in text + page
    for shown in (text, page, (released / "README.md").read_text()):
        assert "Ceiling: of the 100 tasks" in " ".join(shown.split())
    for shown in (text, page):
        assert board.answer() in " ".join(shown.split())
    assert "Families: the core against Random" in " ".join(text.split())
    for name in map(label, TEACHERS):
        assert name in text
        assert f"| {name} |" in page
    assert "only published results" in told(2, "leaderboard", "paper-2021")


def test_the_answer_and_its_picture_come_before_the_table(released: Path) -> None:
    page = markdown(str(released), pictures="images")
    (board,) = leaderboards(load(released))
    ((name, chart),) = difference_charts(str(released))
    picture = f"![Differences to Random, {board.title}](images/{name})"
    assert page.index(board.answer()) < page.index(picture) < page.index("| teacher | in the end, %")
    drawn = ElementTree.fromstring(svg(draw(chart)))
    shown = [text.text for text in drawn.iter("{http://www.w3.org/2000/svg}text")]
    names = [label(entry.teacher) for entry in board.entries if entry.against]
    assert [text for text in shown if text in map(label, TEACHERS)] == names
    assert {"In the end", "Sooner"} <= set(shown)


def test_notes_of_a_release_are_with_leaderboards_of_its_runs(released: Path, tmp_path: Path) -> None:
    note = "Rankings at 5 million steps agree."
    annotated = Path(shutil.copytree(released, tmp_path / "annotated"))
    manifest = find_baseline(released).manifest
    (annotated / BASELINE_FILE).write_bytes(replace(manifest, budget_note=note).to_bytes())
    for steps in (STEPS, STEPS // 2):
        own = SyntheticCampaign(tmp_path / f"own_{steps}", experiment=CHALLENGES[0], steps=steps)
        own.seeds("plr", [40, 50], 100, level="high", challenge=CHALLENGES[0], **NAMES)
        boards = leaderboards(read([annotated, own.root]))
        noted = {int(board.runs["steps"].iloc[0]): note in notes(board) for board in boards}
        assert noted == {STEPS: True, steps: steps == STEPS}
    assert note in markdown(str(annotated))
    assert note not in markdown(str(released))


def test_a_newcomer_leaves_the_core_as_it_is(root: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(root, tmp_path / "root"))
    (before,) = leaderboards(load(root))
    write(root, {"plr:budget=2000000": 3, "sfl:budget=2000000": 3}, name="later")
    (after,) = leaderboards(load(root).with_core(["core"]))
    own = {entry.teacher: entry for entry in after.entries}
    for entry in before.entries:
        pair = entry, own[entry.teacher]
        ranks, now = ({axis: replace(rank, chance=0.0) for axis, rank in e.ranks.items()} for e in pair)
        assert ranks == now
        assert entry.against == own[entry.teacher].against
    newcomers = [entry for entry in after.entries if entry.ranks[FINAL].newcomer]
    assert {after.names[entry.teacher] for entry in newcomers} == {"PLR", "SFL"}
    assert all(rank.of == len(TEACHERS) + 1 for entry in newcomers for rank in entry.ranks.values())
    tests = over_challenges(runs_after(load(root).with_core(["core"])), "last_three")
    assert tests.groupby("family").size().to_dict() == {
        "core": 6, "newcomers": 1, "plr:budget=2000000": 4, "sfl:budget=2000000": 4,
    }  # fmt: skip


@pytest.mark.slow
def test_the_papers_order_agrees_with_itself_and_not_with_its_reverse(root: Path, tmp_path: Path) -> None:
    *places, together = agreements(load(root))
    assert {each.challenge for each in places} == set(CHALLENGES)
    assert all(each.teachers == tuple(sorted(TEACHERS)) for each in places)
    assert [each.tau for each in (*places, together)] == [1.0] * 3
    assert all(each.low < each.high == 1.0 for each in places)
    reverse = agreements(load(write(tmp_path / "reverse", dict.fromkeys(TEACHERS, 3), sign=-1)))
    assert all(each.tau < 0 and each.low == -1.0 for each in reverse[:-1])
    (single, *_) = agreements(load(write(tmp_path / "single", dict.fromkeys(TEACHERS, 1))))
    assert np.isnan([single.low, single.high]).all()


def test_findings_say_what_is_supported_and_by_what(released: Path) -> None:
    text = findings(str(released))
    assert "24 runs of PPO, 2 million steps each, simulated by Chipmunk" in text
    assert "| Mostly trivial, expert knowledge high | 4 | 1.00 |" in text
    assert "| mean over all of these |  | 1.00 |" in text
    assert "Of 21 claims:" in text
    with pytest.raises(BaselineError, match="no runs"):
        findings("paper-2021")


def test_a_complete_release_lacks_nothing(released: Path, told: Told) -> None:
    assert lacking(find_baseline(released)) == []
    assert "it is complete" in told(0, "verify", "--complete", released)


def test_teachers_of_another_campaign_may_have_fewer_seeds(tmp_path: Path) -> None:
    write(tmp_path / "root", {"random": 4, "adr": 4})
    write(tmp_path / "root", {"riac": 3}, name="others")
    assert lacking(find_baseline(add_to_release(tmp_path / "root", "mine", "one", tmp_path, "CC0-1.0"))) == []


@pytest.mark.slow
def test_what_a_release_lacks_is_named(tmp_path: Path, told: Told) -> None:
    root = write(tmp_path / "root", {"random": 2, "adr": 1})
    core = SyntheticCampaign(root, experiment="mostly_trivial", campaign="core", steps=STEPS)
    core.run("riac", 0, "failed")
    place = release(root, "mine", tmp_path, partial=True)
    found = "\n".join(lacking(find_baseline(place)))
    for words in (
        *(
            "runs are missing: 6 of 7 runs are done, 1 failed",
            "no licence",
            "versions of the benchmark: 0, 1",
        ),
        *("1 runs are not done", "name machines", "adr lacks the seeds 1", "2 seeds, fewer than 3"),
    ):
        assert words in found
    said = json.loads(told(1, "verify", "--complete", place, "--json"))
    assert len(said["lacking"]) == found.count("\n") + 1
    assert "is not a release" in told(2, "verify", "--complete", root)
    assert lacking(find_baseline("paper-2021")) == ["it has no runs, only published results"]
