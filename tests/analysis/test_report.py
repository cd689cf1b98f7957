import base64
import gzip
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from synthetic_results import SMALL, SyntheticCampaign

from analysis.pages.report import write_report
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
def test_no_page_is_written_through_a_link_in_a_root(
    campaign: SyntheticCampaign, tmp_path: Path, unpainted: None, link: str
) -> None:
    root, outside = campaign.root, tmp_path / "outside"
    campaign.seeds("random", [1])
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
    first, again = (
        {path.name: path.read_bytes() for path in folder.iterdir()}
        for folder in (full_root / "report", tmp_path / "again")
    )
    assert first.keys() == again.keys()
    assert [name for name in first if first[name] != again[name]] in ([], ["index.html"])  # its date


def test_an_empty_root(small: SyntheticCampaign) -> None:
    page = report(small.root)
    assert "This root holds no runs yet." in page.text
    assert not page.images


def test_no_root_at_all(tmp_path: Path) -> None:
    with pytest.raises(ResultsRootError):
        write_report(tmp_path / "nowhere")


def test_an_object_store_needs_an_output() -> None:
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
def test_what_is_said_of_teachers_that_are_not_better(
    random: list[int], adr: list[int], words: list[str], campaign: SyntheticCampaign
) -> None:
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


def damage(path: Path) -> None:
    path.write_bytes(b"not Parquet")


@pytest.mark.usefixtures("unpainted")
@pytest.mark.parametrize("harm", [damage, pytest.param(Path.unlink, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::tma_ray.results.DamagedFileWarning")
def test_damaged_files_are_left_out_named(campaign: SyntheticCampaign, harm: Callable[[Path], None]) -> None:
    campaign.seeds("random", [1])
    campaign.seeds("alp_gmm", [2])
    harm(next((campaign.root / "tables" / "evaluations").glob("*random*")))
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
