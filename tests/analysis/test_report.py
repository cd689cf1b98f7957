import base64
import gzip
import json
import re
import shutil
from collections.abc import Callable
from html.parser import HTMLParser
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic_results import SMALL, SyntheticCampaign

from analysis import load
from analysis.baselines import add_to_release
from analysis.commands.paper import write_latex
from analysis.comparisons.comparison import Measurements, leading
from analysis.comparisons.pairwise import pairwise
from analysis.data.reference import BASELINE
from analysis.formatting import listed, number
from analysis.measures.pooling import runs_after
from analysis.measures.tested import AXES, FINAL, verdict
from analysis.pages.compare import write_comparison
from analysis.pages.report import Video, subject, video_requests, write_report
from analysis.pages.sections import answers, distinct
from tma_ray.cli import reporting
from tma_ray.results import ResultsRootError, Table

HOSTILE = "<script>alert('$x^')</script>"


class Page(HTMLParser):
    """What a browser would load, show and embed."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.source = source
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.charts: list[str] = []
        self.text = ""
        self._quiet = False
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._quiet = tag in ("script", "style")
        named = dict(attrs)
        self.loads += [named[name] or "" for name in ("src", "href", "srcset", "data") if name in named]
        if tag == "img":
            self.images.append(named)
        if "data-chart" in named:
            self.charts.append(named["data-chart"] or "")

    def handle_endtag(self, tag: str) -> None:
        self._quiet = self._quiet and tag not in ("script", "style")

    def handle_data(self, data: str) -> None:
        self.text += "" if self._quiet else data

    @property
    def words(self) -> str:
        return re.sub(r"\s+", " ", self.text)


@pytest.fixture
def small(tmp_path: Path) -> SyntheticCampaign:
    return SyntheticCampaign(tmp_path / "root", **SMALL)


def report(root: Path) -> Page:
    return Page(write_report(root).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def full_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("full")
    campaign = SyntheticCampaign(root, boxes=True, **SMALL | {"updates": 1})
    for teacher in ("random", "alp_gmm", HOSTILE):
        for seed in range(3):
            campaign.run(teacher, seed)
    return root


@pytest.fixture(scope="module")
def full(full_root: Path) -> Page:
    return report(full_root)


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not painted, which takes most of a report's time: for tests of the words."""
    monkeypatch.setattr("analysis.charts.paper.style.png", lambda figure: b"\x89PNG")


@pytest.mark.parametrize("link", ["report", "report/index.html", "report/latex"])
def test_no_page_is_written_through_a_link_in_a_root(campaign, tmp_path, unpainted, link):
    root, outside = campaign.root, tmp_path / "outside"
    campaign.seeds("random", [1])
    outside.mkdir()
    (outside / "index.html").write_text("theirs")
    (root / link).parent.mkdir(exist_ok=True)
    (root / link).symlink_to(outside / "index.html" if "html" in link else outside)
    refusal = rf"root/{link} is a symbolic link.*remove it, or say in which folder"
    with pytest.raises(ValueError, match=refusal):
        write_report(root)
    assert [path.read_text() for path in outside.iterdir()] == ["theirs"]
    assert write_report(root, tmp_path / "page").exists()


def test_the_page_loads_nothing_from_elsewhere(full: Page) -> None:
    assert full.loads
    assert all(address.startswith(("data:", "#")) for address in full.loads)
    assert not {"link", "iframe", "object"} & set(full.tags)
    style = full.source[full.source.index("<style>") : full.source.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_a_hostile_name_is_only_text(full: Page) -> None:
    assert HOSTILE in full.words
    assert HOSTILE not in full.source


def test_charts_are_described_and_say_of_how_many_seeds(full: Page) -> None:
    captions = re.findall(r"n = 3 seeds per teacher", full.words)
    assert len(captions) == 5  # three curves, seed by seed, mastered tasks
    for title in ("Training tasks", "Probed tasks", "Seed by seed"):
        assert title in full.words


def test_teachers_logs_are_charts_that_fit_any_page(full: Page, full_root: Path) -> None:
    assert not full.images
    assert not list((full_root / "report").glob("*.png"))
    assert re.search(r'data-chart="comparison-\d-teacher-log-alp_gmm-1" data-of="alp_gmm"', full.source)
    assert "Teachers' logs" in full.words


def test_tables_are_embedded_and_lie_beside_the_page(full: Page, full_root: Path) -> None:
    beside = {path.read_bytes() for path in (full_root / "report").glob("*.csv")}
    links = [address for address in full.loads if address.startswith("data:application/gzip")]
    assert {gzip.decompress(base64.b64decode(link.partition("base64,")[2])) for link in links} == beside
    assert len(beside) == 7


def test_the_page_says_what_the_tables_hold(full: Page, full_root: Path) -> None:
    summary = pd.read_csv(full_root / "report" / "summary.csv").set_index("teacher")
    assert set(summary.index) == {"random", "alp_gmm", HOSTILE}
    mean, std = (summary.loc["alp_gmm", f"mastered_area_{name}"] for name in ("mean", "std"))
    assert f"ALP-GMM masters the most test tasks over training: {mean:.1f} ± {std:.1f}" in full.words
    tests = pd.read_csv(full_root / "report" / "tests.csv").set_index(["measure", "teacher"])
    p = tests.loc[("mastered_area", "alp_gmm"), "holm"]
    assert (f"p = {p:.3f}" if p >= 0.001 else "p\N{NO-BREAK SPACE}< 0.001") in full.text
    assert "only large differences can show" in full.text
    assert (
        "Tests are of what is shown, in per cent; Holm's correction covers all teachers of a comparison"
        in full.words
    )
    assert re.search(r"Ceiling: of the \d+ tasks of test set \w+, \d+ are mastered by any run", full.words)


def test_the_same_root_gives_the_same_figures_and_tables(full: Page, full_root: Path, tmp_path: Path) -> None:
    write_report(full_root, tmp_path / "again")
    folders = (full_root / "report", tmp_path / "again")
    first, again = ({path.name: path.read_bytes() for path in folder.iterdir()} for folder in folders)
    assert first.keys() == again.keys()
    assert [name for name in first if first[name] != again[name]] in ([], ["index.html"])  # its date


def test_an_empty_root(small: SyntheticCampaign) -> None:
    page = report(small.root)
    assert "This root holds no runs yet." in page.text
    assert not page.images


def test_what_makes_no_report_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ResultsRootError):
        write_report(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="which folder"):
        write_report("s3://bucket/results")


@pytest.mark.usefixtures("unpainted")
def test_one_seed_concludes_nothing(small: SyntheticCampaign) -> None:
    for teacher in ("random", "alp_gmm"):
        small.run(teacher, 0)
    page = report(small.root)
    assert "a single seed cannot tell skill from luck" in page.words
    assert "needs 2 seeds" in page.text
    assert "significant difference" not in page.words


@pytest.mark.usefixtures("unpainted")
def test_failed_runs_are_named_with_their_error(small: SyntheticCampaign) -> None:
    for seed in range(2):
        small.run("random", seed)
        small.run("alp_gmm", seed, "failed" if seed else "done", 0.5 if seed else 1.0)
    page = report(small.root)
    assert "1 failed" in page.text
    assert "MemoryError: buffer of 2 GB" in page.text
    assert "Give the command that started the campaign once more" in page.words
    assert "1 of 2" in page.text


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_a_campaign_under_way(small: SyntheticCampaign) -> None:
    for seed in range(2):
        small.run("random", seed)
        small.run("alp_gmm", seed, "running", 0.5 + 0.25 * seed)
    small.run("alp_gmm", 2, "waiting")
    page = report(small.root)
    assert "2 running or interrupted, 1 not started" in page.words
    assert "So far, over 20 thousand steps, ALP-GMM" in page.words
    assert "still running" in page.text
    assert "p =" not in page.text


UNTESTED = "Nothing mastered: no seed masters any test task, so teachers are not compared."
ALONE = "Other teachers were not run."
NOBODY = "No teacher does better than Random. Worse than Random: ADR."


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize(
    ("random", "adr", "words"),
    [
        ([1], [], [ALONE]),
        ([0, 0, 0], [0, 0, 0], [UNTESTED, "Mastered, minus Random", "no spread between seeds"]),
        ([5, 6, 5, 6, 5], [3, 3, 3, 3, 3], [NOBODY]),
    ],
    ids=["one teacher", "nothing mastered", "none better"],
)
def test_what_is_said_of_teachers_that_are_not_better(random, adr, words, campaign):
    campaign.seeds("random", random)
    campaign.seeds("adr", adr)
    page = report(campaign.root)
    assert [text for text in words if text not in page.words] == []
    assert "better than Random" not in page.words.replace(NOBODY, "")


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_a_campaign_whose_runs_have_only_begun(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {}, "running")
    page = report(campaign.root)
    assert "No evaluation has finished yet" in page.text
    assert "not evaluated yet" in page.text


@pytest.mark.slow
def test_test_tasks_in_no_grid_and_a_larger_task_space(campaign: SyntheticCampaign) -> None:
    space = json.dumps({"task_space": [{"name": name, "low": 0, "high": 1, "unit": ""} for name in "abc"]})
    campaign.seeds("random", [1, 2], 3, spec=space)
    charts = ["mastered-percent", "evaluation-return", "seeds", "mastery-line-random"]
    assert report(campaign.root).charts == [*(f"comparison-1-{name}" for name in charts), "profiles-1"]


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_warnings_are_shown(campaign: SyntheticCampaign) -> None:
    campaign.plain_run("random", 0, {1000: [300]})
    campaign.plain_run("random", 1, {1000: [300]}, physics_version=2)
    assert "stand apart: physics version 1" in report(campaign.root).text


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("remains", [b"not Parquet", pytest.param(None, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::tma_ray.results.DamagedFileWarning")
def test_damaged_files_are_left_out_named(campaign: SyntheticCampaign, remains: bytes | None) -> None:
    campaign.seeds("random", [1])
    campaign.seeds("alp_gmm", [2])
    (file,) = (campaign.root / "tables" / "evaluations").glob("*random*")
    file.unlink() if remains is None else file.write_bytes(remains)
    page = report(campaign.root)
    assert "was left out" in page.text
    assert "ALP-GMM masters" in page.words


@pytest.mark.slow
@pytest.mark.parametrize("highs", [(1,), (1, 0), (1, 1, 1)])
def test_a_world_with_a_task_space_of_its_own(campaign: SyntheticCampaign, highs: tuple[int, ...]) -> None:
    space = [{"name": f"x{i}", "low": 0, "high": high, "unit": "m"} for i, high in enumerate(highs)]
    spec = json.dumps({"mastery_threshold": -200.0, "task_space": space})
    record = campaign.record("random", 0, "low", spec=spec)
    campaign.cell(record, "low")
    task = np.zeros(len(highs), np.float32)
    evaluation = {"step": 1000, "test_set": "own", "task_index": 0, "task": task, "length": 1}
    episode = {"step": 10, "episode": 0, "task": task, "length": 10, "success": False}
    tables = {
        Table.EVALUATIONS: [evaluation | {"episodic_return": -100.0}],
        Table.EPISODES: [episode | {"episodic_return": -300.0}],
        Table.CURRICULUM: [{"step": step, "sample": 0, "task": task} for step in (0, 1000)],
    }
    campaign._write(record, "done", tables, 1000)
    page = report(campaign.root)
    assert "return on the task is over \N{MINUS SIGN}200" in page.words
    assert {"comparison-1-training-tasks-random", "comparison-1-probed-tasks-random"} <= set(page.charts)
    assert any("dimension by dimension" in (image["alt"] or "") for image in page.images)
    assert "over \N{MINUS SIGN}200. Each seed" in page.words
    assert "masters 100.0" in page.words


COUNTS = {"random": (1, 2, 1, 2), "adr": (7, 8, 7, 8), "riac": (1, 1, 2, 2)}
"""Mastered tasks of ten, seed by seed."""


@pytest.fixture(scope="module")
def hills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two campaigns, each of one challenge; ADR is better than Random on the first alone."""
    folder = tmp_path_factory.mktemp("answer") / "hills"
    for challenge in ("original", "mostly_trivial"):
        campaign = SyntheticCampaign(folder, experiment=challenge, campaign=f"on_{challenge}", steps=1000)
        for teacher, counts in COUNTS.items():
            alike = COUNTS["random"] if challenge == "mostly_trivial" else counts
            campaign.seeds(teacher, alike, level="high", challenge=challenge)
    return folder


def test_a_report_is_called_by_its_campaign_its_folder_or_its_release(hills: Path) -> None:
    assert subject(hills, ["first_look"]) == "First look"
    assert subject(hills, ["on_mostly_trivial", "on_original"]) == "hills"
    assert subject(hills, []) == "Training runs"
    release = add_to_release(hills, "peaks", "one", hills.parent, "CC0-1.0")
    assert subject([hills, release], ["on_mostly_trivial", "on_original"]) == "hills, peaks"


def test_the_matrix_has_every_test_against_random_over_all_challenges_and_on_each(hills: Path) -> None:
    frames = load(hills)
    (answer,) = answers(frames)
    assert answer.sentence.startswith("The best teacher, sooner and in the end, is ADR (probability 0.99)")
    assert [row.name for row in answer.rows] == ["ADR", "RIAC"]
    assert answer.columns == ["All challenges", "Mostly trivial", "Original"]
    cells = {row.teacher: dict(zip(answer.columns, row.cells, strict=True)) for row in answer.rows}
    for place, axis in enumerate((FINAL, *(axis for axis in AXES if axis != FINAL))):
        tests = pairwise(runs_after(frames), axis, BASELINE)
        for _, test in tests.iterrows():
            title = "Original" if test["challenge"] == "original" else "Mostly trivial"
            cell = cells[test["first"]][title][place]
            assert cell.text == number(test["difference"])
            assert cell.decided == {"better": "better", "worse": "worse"}.get(verdict(test), "")
    assert cells["adr"]["All challenges"][0].decided == cells["adr"]["Original"][0].decided == "better"
    assert cells["adr"]["Mostly trivial"][0].decided == ""


def test_a_report_of_several_comparisons_begins_with_the_answer_and_folds_them(hills: Path) -> None:
    page = write_report(hills).read_text()
    assert "<h1>hills</h1>" in page
    assert "2 campaigns</summary>" in page
    places = [page.index(text) for text in ("The best teacher", 'class="matrix"', 'id="overview-section"')]
    assert places == sorted(places)
    assert page.count('<details class="comparison">') == 2 + 1  # and the chart of all
    rows = page[places[-1] : page.index("</tbody>", places[-1])]
    assert rows.count("<tr data-comparison=") == 2
    assert "ADR" in rows


@pytest.fixture
def told_apart(campaign: SyntheticCampaign) -> Path:
    """Task 1 tells the runs apart; seed 2 of ADR is the best, seed 0 the worst."""
    campaign.plain_run("random", 0, {1000: [300.0, -100.0, 10.0]})
    for seed, value in enumerate((0.0, 240.0, 300.0)):
        campaign.plain_run("adr", seed, {1000: [300.0 - seed, value, 10.0]})
    return campaign.root


def test_the_best_and_the_worst_seed_play_the_task_that_tells_runs_apart(told_apart: Path) -> None:
    requests = list(video_requests(Measurements(load(told_apart))))
    found = [(each.teacher, each.seed, each.rank) for each in requests]
    assert found == [("random", 0, "only"), ("adr", 2, "best"), ("adr", 0, "worst")]
    assert {(each.test_set, each.task_index, each.task) for each in requests} == {("line", 1, "1")}


@pytest.mark.parametrize(("ending", "element"), [("mp4", "<video"), ("gif", "<img")])
@pytest.mark.slow
def test_videos_are_embedded_with_ends(told_apart: Path, tmp_path: Path, ending: str, element: str) -> None:
    file = tmp_path / f"one.{ending}"
    file.write_bytes(b"moving")
    assert "Policies at work" not in write_report(told_apart).read_text()
    videos = [Video(each, file, 123.4) for each in video_requests(Measurements(load(told_apart)))]
    text = re.sub(r"\s+", " ", write_report(told_apart, videos=videos).read_text())
    assert text.count("base64,bW92aW5n") == 3
    assert f"{element} " in text
    assert "ADR, seed 2 (its best seed by mastered tasks), on test task 1 (1): return 123.4" in text


@pytest.mark.slow
def test_latex_shows_every_table_and_figure_it_wrote(told_apart: Path, tmp_path: Path) -> None:
    (document,) = write_latex(told_apart, tmp_path / "latex").files
    text = document.read_text()
    inputs = re.findall(r"\\input\{(.+?)\}", text)
    pictures = re.findall(r"\\includegraphics\[.*?\]\{\{(.+?)\}\.pdf\}", text)
    assert {(document.parent / name) for name in inputs} == set((document.parent / "tables").glob("*.tex"))
    written = {str(path) for path in (document.parent / "figures").glob("*.pdf")}
    assert {f"{document.parent / name}.pdf" for name in pictures} == written
    assert inputs
    assert pictures


def test_rows_of_an_overview_leave_out_what_all_share() -> None:
    titles = ["Stump Tracks, original, PPO", "Stump Tracks, mostly trivial, PPO"]
    assert distinct(titles) == ["original", "mostly trivial"]
    assert distinct(["same, parts", "same, parts"]) == ["same, parts", "same, parts"]


def test_titles_name_the_place_once_and_experiments_where_titles_would_be_equal(tmp_path: Path) -> None:
    for experiment, environment in {"plain": "parkour", "swinging": "parkour:swinging_creepers=true"}.items():
        walker = {"environment": environment, "test_set": "parkour_walking"}
        SyntheticCampaign(tmp_path, steps=1000, experiment=experiment).seeds("riac", (1, 2), **walker)
    for experiment in ("original", "again"):
        campaign = SyntheticCampaign(tmp_path, steps=1000, experiment=experiment)
        campaign.seeds("riac", (1, 2), challenge="original")
    known = "Stump Tracks, original task space, classic bipedal, SAC, expert knowledge low"
    assert sorted(comparison.title for comparison in Measurements(load(tmp_path)).comparisons) == [
        "Parkour (swinging_creepers=true), classic bipedal, SAC, expert knowledge low",
        "Parkour, classic bipedal, SAC, expert knowledge low",
        f"again, {known}",
        f"original, {known}",
    ]


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
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("many")
    campaign = SyntheticCampaign(folder, experiment="original", steps=1000)
    for place, teacher in enumerate(TEACHERS):
        campaign.seeds(teacher, [place] * 2, 14, level="none")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "write", [write_report, lambda many: write_comparison(many, ["paper-2021"])], ids=["report", "compare"]
)
def test_a_page_of_many_teachers_is_short_to_read(write: Callable[[Path], Path], many: Path) -> None:
    text = write(many).read_text()
    checked = re.findall(r'<input type="checkbox" checked data-teacher="(\w+)">', text)
    assert set(checked) == {"random", *TEACHERS[-8:]}
    assert len(re.findall(r'<input type="checkbox" data-teacher="(\w+)">', text)) == 5
    assert "5 more</summary>" in text
    open_sentences = re.sub(r"<details>.*?</details>", "", text, flags=re.DOTALL)
    said = re.findall(r"<p>(?:<b>)?[^<]*(?:Over 1 challenge|is better than|distinguishable)", open_sentences)
    assert len(said) <= 24


NOTEBOOKS = Path(__file__).parents[2] / "notebooks" / "data" / "ppo-lite"


def test_only_what_runs_publish_counts_as_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = Path(shutil.copytree(NOTEBOOKS, tmp_path / "root"))
    manifest = next((root / "manifests").iterdir())
    looks: list[float] = []

    def look(seconds: float) -> None:
        looks.append(seconds)
        if len(looks) == 2:
            (root / "report").mkdir()
        if len(looks) % 3 == 0:
            manifest.write_bytes(manifest.read_bytes() + b" ")

    monkeypatch.setattr(reporting.time, "sleep", look)
    list(islice(reporting.changes([str(root), "paper-2021"], 5.0), 2))
    assert looks == [5.0] * 6
