import base64
import csv
import gzip
import io
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from synthetic_results import SyntheticCampaign

from analysis.pages.report import write_report
from tma_ray.results import ResultsRootError, Table

HOSTILE = "<script>alert('$x^')</script>"


class Page(HTMLParser):
    """What a browser would load, show and embed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.charts: list[str] = []
        self.text = ""
        self._quiet = False
        self.feed(text)

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


def small(root: Path, **changes: object) -> SyntheticCampaign:
    return SyntheticCampaign(
        root,
        **(
            {"steps": 40_000, "evaluation_every": 10_000, "episode_steps": 1_000, "grid": 4, "updates": 1}
            | changes
        ),
    )


def report(root: Path) -> Page:
    return Page(write_report(root).read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def full_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("full")
    campaign = small(root, boxes=True)
    for teacher in ("random", "alp_gmm", HOSTILE):
        for seed in range(3):
            campaign.run(teacher, seed)
    write_report(root)
    return root


@pytest.fixture(scope="module")
def full(full_root: Path) -> Page:
    return Page((full_root / "report" / "index.html").read_text(encoding="utf-8"))


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made, but not painted, which takes most of a report's time: for tests of the words."""
    monkeypatch.setattr("analysis.charts.paper.style.png", lambda figure: b"\x89PNG")


@pytest.mark.parametrize("link", ["report", "report/index.html", "report/latex"])
def test_no_page_is_written_through_a_link_in_a_root(tmp_path: Path, unpainted: None, link: str) -> None:
    root, outside = tmp_path / "root", tmp_path / "outside"
    small(root).run("random", 0)
    outside.mkdir()
    (outside / "index.html").write_text("theirs")
    (root / link).parent.mkdir(exist_ok=True)
    (root / link).symlink_to(outside / "index.html" if "html" in link else outside)
    with pytest.raises(
        ValueError, match=rf"root/{link} is a symbolic link.*remove it, or say in which folder"
    ):
        write_report(root)
    assert [path.read_text() for path in outside.iterdir()] == ["theirs"]
    assert write_report(root, tmp_path / "page").exists()


def test_the_page_loads_nothing_from_elsewhere(full: Page) -> None:
    assert full.loads
    assert all(address.startswith(("data:", "#")) for address in full.loads)
    assert not {"link", "iframe", "object"} & set(full.tags)


def test_style_imports_nothing(full_root: Path) -> None:
    page = (full_root / "report" / "index.html").read_text(encoding="utf-8")
    style = page[page.index("<style>") : page.index("</style>")]
    assert "url(" not in style
    assert "@import" not in style


def test_a_hostile_name_is_only_text(full: Page, full_root: Path) -> None:
    assert HOSTILE in full.words
    whole = (full_root / "report" / "index.html").read_text(encoding="utf-8")
    assert HOSTILE not in whole


def test_charts_are_described_and_say_of_how_many_seeds(full: Page) -> None:
    captions = re.findall(r"n = 3 seeds per teacher", full.words)
    assert len(captions) == 5  # three curves, seed by seed, mastered tasks
    for title in ("Training tasks", "Probed tasks", "Seed by seed"):
        assert title in full.words


def test_teachers_logs_are_charts_that_fit_any_page(full: Page, full_root: Path) -> None:
    assert not full.images
    assert not list((full_root / "report").glob("*.png"))
    whole = (full_root / "report" / "index.html").read_text(encoding="utf-8")
    assert re.search(r'data-chart="comparison-\d-teacher-log-alp_gmm-1" data-of="alp_gmm"', whole)
    assert "Teachers' logs" in full.words or "Teachers&#39; logs" in whole


def test_tables_are_embedded_and_lie_beside_the_page(full: Page, full_root: Path) -> None:
    beside = {path.read_bytes() for path in (full_root / "report").glob("*.csv")}
    links = [address for address in full.loads if address.startswith("data:application/gzip")]
    assert {gzip.decompress(base64.b64decode(link.partition("base64,")[2])) for link in links} == beside
    assert len(beside) == 7


def read_csv(root: Path, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO((root / "report" / name).read_text(encoding="utf-8"))))


def test_the_page_says_what_the_tables_hold(full: Page, full_root: Path) -> None:
    summary = {row["teacher"]: row for row in read_csv(full_root, "summary.csv")}
    assert set(summary) == {"random", "alp_gmm", HOSTILE}
    mean, std = (float(summary["alp_gmm"][f"mastered_area_{name}"]) for name in ("mean", "std"))
    assert f"ALP-GMM masters the most test tasks over training: {mean:.1f} ± {std:.1f}" in full.words
    tests = {
        row["teacher"]: row for row in read_csv(full_root, "tests.csv") if row["measure"] == "mastered_area"
    }
    p = float(tests["alp_gmm"]["holm"])
    assert (f"p = {p:.3f}" if p >= 0.001 else "p\N{NO-BREAK SPACE}< 0.001") in full.text
    assert "only large differences can show" in full.text
    assert (
        "Tested on the arcsine scale; Holm's correction covers all teachers of a comparison against Random"
        in full.words
    )
    assert re.search(r"Ceiling: of the \d+ tasks of test set \w+ \d+ are mastered by any run", full.words)


def test_the_same_root_gives_the_same_figures_and_tables(full_root: Path, tmp_path: Path) -> None:
    write_report(full_root, tmp_path / "again")
    first = {path.name: path.read_bytes() for path in (full_root / "report").iterdir()}
    again = {path.name: path.read_bytes() for path in (tmp_path / "again").iterdir()}
    assert first.keys() == again.keys()
    assert [name for name in first if first[name] != again[name]] in ([], ["index.html"])  # its date


def test_an_empty_root(tmp_path: Path) -> None:
    small(tmp_path)
    page = report(tmp_path)
    assert "This root holds no runs yet." in page.text
    assert not page.images


def test_no_root_at_all(tmp_path: Path) -> None:
    with pytest.raises(ResultsRootError):
        write_report(tmp_path / "nowhere")


def test_an_object_store_needs_an_output() -> None:
    with pytest.raises(ValueError, match="which folder"):
        write_report("s3://bucket/results")


@pytest.mark.usefixtures("unpainted")
def test_one_seed_concludes_nothing(tmp_path: Path) -> None:
    campaign = small(tmp_path)
    campaign.run("random", 0)
    campaign.run("alp_gmm", 0)
    page = report(tmp_path)
    assert "a single seed cannot tell skill from luck" in page.words
    assert "needs 2 seeds" in page.text
    assert "significant difference" not in page.words


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_one_teacher_alone(tmp_path: Path) -> None:
    small(tmp_path).run("random", 0)
    assert "Other teachers were not run." in report(tmp_path).words


@pytest.mark.usefixtures("unpainted")
def test_failed_runs_are_named_with_their_error(tmp_path: Path) -> None:
    campaign = small(tmp_path)
    for seed in range(2):
        campaign.run("random", seed)
        campaign.run("alp_gmm", seed, "failed" if seed else "done", 0.5 if seed else 1.0)
    page = report(tmp_path)
    assert "1 failed" in page.text
    assert "MemoryError: buffer of 2 GB" in page.text
    assert "Give the command that started the campaign once more" in page.words
    assert "1 of 2" in page.text


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_a_campaign_under_way(tmp_path: Path) -> None:
    campaign = small(tmp_path)
    for seed in range(2):
        campaign.run("random", seed)
        campaign.run("alp_gmm", seed, "running", 0.5 + 0.25 * seed)
    campaign.run("alp_gmm", 2, "waiting")
    page = report(tmp_path)
    assert "2 running or interrupted, 1 not started" in page.words
    assert "So far, over 20 thousand steps, ALP-GMM" in page.words
    assert "still running" in page.text
    assert "p =" not in page.text


@pytest.mark.slow
def test_a_campaign_whose_runs_have_only_begun(tmp_path: Path) -> None:
    campaign = small(tmp_path)
    record = campaign.record("random", 0, "low")
    campaign.cell(record, "low")
    campaign.committer.start(record)
    page = report(tmp_path)
    assert "No evaluation has finished yet" in page.text
    assert "not evaluated yet" in page.text


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_where_nothing_is_mastered_nothing_is_compared(tmp_path: Path) -> None:
    campaign = small(tmp_path, steps=1000)
    for seed in range(3):
        campaign.plain_run("random", seed, {0: [0, 0], 1000: [10 + seed, 0]})
        campaign.plain_run("adr", seed, {0: [0, 0], 1000: [90 + seed, 0]})
    page = report(tmp_path)
    assert "Nothing mastered: no seed masters any test task, so teachers are not compared." in page.words
    assert "Mastered, minus Random" in page.words
    assert "better than Random" not in page.words
    assert "no spread between seeds" in page.words


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_no_teacher_better_than_random(tmp_path: Path) -> None:
    campaign = small(tmp_path, steps=1000)
    for seed, mastered in enumerate([5, 6, 5, 6, 5]):
        campaign.plain_run("random", seed, {1000: [300] * mastered})
        campaign.plain_run("adr", seed, {1000: [300] * 3 + [0] * mastered})
    page = report(tmp_path)
    assert "No teacher does better than Random. Significantly worse than Random: ADR." in page.words


@pytest.mark.slow
def test_test_tasks_in_no_grid_and_a_larger_task_space(tmp_path: Path) -> None:
    campaign = small(tmp_path, steps=1000)
    space = json.dumps({"task_space": [{"name": name, "low": 0, "high": 1, "unit": ""} for name in "abc"]})
    for seed in range(2):
        campaign.plain_run("random", seed, {1000: [300, 0, 300 * seed]}, spec=space)
    charts = ["mastered-percent", "evaluation-return", "seeds", "mastery-line-random"]
    assert report(tmp_path).charts == [*(f"comparison-1-{name}" for name in charts), "profiles-1"]


@pytest.mark.slow
@pytest.mark.usefixtures("unpainted")
def test_warnings_are_shown(tmp_path: Path) -> None:
    campaign = small(tmp_path, steps=1000)
    campaign.plain_run("random", 0, {1000: [300]})
    campaign.plain_run("random", 1, {1000: [300]}, physics_version=2)
    assert "stand apart: physics version 1" in report(tmp_path).text


def damage(root: Path) -> None:
    path = next((root / "tables" / "evaluations").glob("*random*"))
    path.write_bytes(b"not Parquet")


def remove(root: Path) -> None:
    next((root / "tables" / "evaluations").glob("*random*")).unlink()


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("harm", [damage, pytest.param(remove, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::tma_ray.results.DamagedFileWarning")
def test_a_damaged_file_is_left_out_and_named(tmp_path: Path, harm: Callable[[Path], None]) -> None:
    campaign = small(tmp_path)
    campaign.run("random", 0)
    campaign.run("alp_gmm", 0)
    harm(tmp_path)
    page = report(tmp_path)
    assert "was left out" in page.text
    assert "ALP-GMM masters" in page.words


@pytest.mark.slow
@pytest.mark.parametrize(
    "highs",
    [pytest.param((1,), marks=pytest.mark.slow), (1, 0), pytest.param((1, 1, 1), marks=pytest.mark.slow)],
)
def test_a_world_with_a_threshold_and_a_task_space_of_its_own(tmp_path: Path, highs: tuple[int, ...]) -> None:
    campaign = small(tmp_path, steps=1000)
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
    page = report(tmp_path)
    assert "return on the task is over \N{MINUS SIGN}200" in page.words
    assert {"comparison-1-training-tasks-random", "comparison-1-probed-tasks-random"} <= set(page.charts)
    assert any("dimension by dimension" in (image["alt"] or "") for image in page.images)
    assert "over \N{MINUS SIGN}200. Each seed" in page.words
    assert "masters 100.0" in page.words
