"""The paper's tables: its own numbers as it printed them, and results of invented roots."""

import csv
import io
import json
import re
from pathlib import Path

import pandas as pd
import pytest
from synthetic_pools import parkour, pool
from synthetic_results import SyntheticCampaign

from analysis.commands.paper import write_tables
from analysis.data.loading import load
from analysis.measures.pooling import pooled
from analysis.tables.paper_tables import (
    TableResults,
    hyperparameters,
    knowledge_needs,
    published_table_results,
    result_tables,
    results_of,
    table_results,
)
from analysis.tables.table import DASH, ResultTable, TableCell, TableFormat, render, with_best
from tma_ray.benchmark import TEACHER_GRIDS, paper_results

SINGLE = ("mostly_unfeasible", "mostly_trivial", "forgetting_student", "rugged_difficulty")
CHALLENGES = {**dict.fromkeys(SINGLE, "alp_gmm"), "diverse_students": "covar_gmm"}

BEST = {
    "original_space": {"none": "alp_gmm", "low": "alp_gmm", "high": "goal_gan"},
    "challenges_none": CHALLENGES,
    "challenges_low": CHALLENGES,
    "challenges_high": CHALLENGES | {"mostly_trivial": "goal_gan"},
    "parkour": {"classic_bipedal": "alp_gmm", "fish": "riac", "climbing_chimpanzee": "spdl"}
    | {"overall": "alp_gmm"},
}
"""What the paper prints in bold."""


def paper_tables() -> dict[str, ResultTable]:
    return {table.name: table for table in result_tables(published_table_results())}


def tables_of_root(root: Path, step: int | None = None) -> dict[str, ResultTable]:
    found = table_results(load(root), step)
    return {table.name: table for results in found for table in result_tables(results)}


def test_the_papers_best_cells_are_the_best() -> None:
    tables = paper_tables()
    for name, columns in BEST.items():
        table = tables[name]
        marked = {key for key in table.cells if table.cells[key].best}
        assert marked == {(teacher, column) for column, teacher in columns.items()}


def test_the_papers_numbers_are_all_there_as_printed() -> None:
    text = "\n".join(render(table, TableFormat.MARKDOWN) for table in paper_tables().values())
    for result in paper_results():
        mean = f"{result.mean:.1f}" if round(result.mean, 1) == result.mean else f"{result.mean:.2f}"
        assert f"{mean} ± {result.std:.1f}" in text
    cells = [cell for table in paper_tables().values() for cell in table.cells.values() if cell.has_number]
    assert len(cells) == len(paper_results())


def test_the_papers_gaps_and_doubts_have_notes() -> None:
    table = paper_tables()["original_space"]
    text = render(table, TableFormat.MARKDOWN)
    assert f"| ADR | {DASH}<sup>a</sup> | 24.1 ± 20.8 |" in text
    assert "<sup>a</sup> cannot run without the reward mastery range" in text
    assert "25.3 ± 10.7<sup>b</sup>" in text
    assert "<sup>b</sup> doubtful: cannot run without knowledge" in text
    assert "Box2D" in text
    assert "32 runs each" in text


def test_numbers_of_runs_stand_where_they_differ() -> None:
    text = render(paper_tables()["challenges_low"], TableFormat.MARKDOWN)
    assert "Mostly trivial (n = 32)" in text
    assert "Diverse students (n = 128)" in text
    cells = {("a", "x"): TableCell(2, 1.0, 0.5), ("b", "x"): TableCell(3, 2.0, 0.5)}
    table = ResultTable("t", "T", "Teacher", {"a": "A", "b": "B"}, {"x": "X"}, cells)
    assert "1.0 ± 0.5 (n = 2)" in render(table, TableFormat.MARKDOWN)


def test_latex_is_booktabs_with_the_best_in_bold() -> None:
    text = render(paper_tables()["original_space"], TableFormat.LATEX)
    assert r"\textbf{52.1 $\pm$ 5.9} & \textbf{47.1 $\pm$ 13.9} & 49.3 $\pm$ 5.9 \\" in text
    assert r"\toprule" in text
    assert r"mostly\_unfeasible" in text
    assert "--" in text.split(r"\midrule")[1]
    assert len(re.findall(r"(?<!\\)[&]", text.split(r"\midrule")[1])) == 3 * 7


@pytest.mark.parametrize("kind", TableFormat)
def test_a_hostile_name_stays_a_name(kind: TableFormat) -> None:
    name = "a|b_c&d\\e<f>\n=g"
    table = ResultTable("t", "T", "Teacher", {name: name}, {"x": "X"}, {(name, "x"): TableCell(1, 2.0)})
    text = render(table, kind)
    if kind is TableFormat.CSV:
        assert next(csv.DictReader(io.StringIO(text)))["row"] == name
    else:
        escaped = {TableFormat.MARKDOWN: r"a\|b\_c&d\\e", TableFormat.LATEX: r"a|b\_c\&d\textbackslash{}e"}
        assert escaped[kind] in text
        assert "<f>" not in text.replace(r"\<f\>", "")


def test_csv_holds_the_numbers_and_flags_of_each_cell() -> None:
    rows = list(csv.DictReader(io.StringIO(render(paper_tables()["original_space"], TableFormat.CSV))))
    found = {(row["row"], row["column"]): row for row in rows}
    best = found["alp_gmm", "none"]
    assert (best["n"], best["mean"], best["std"], best["best"]) == ("32", "52.1", "5.9", "yes")
    assert found["adr", "none"]["mean"] == ""
    assert "mastery range" in found["adr", "none"]["missing"]
    assert found["setter_solver", "none"]["doubt"]


def test_best_is_what_reads_highest_and_needs_something_lower() -> None:
    def best_of(*means: float) -> list[bool]:
        rows = {str(place): str(place) for place in range(len(means))}
        cells = {(row, "x"): TableCell(1, mean) for row, mean in zip(rows, means, strict=True)}
        table = with_best(ResultTable("t", "T", "T", rows, {"x": "X"}, cells))
        return [cell.best for cell in table.column_cells("x")]

    assert best_of(1.0, 2.04, 1.96) == [False, True, True]
    assert best_of(5.0) == [False]
    assert best_of(0.0, 0.0) == [False, False]
    assert best_of(float("nan"), 1.0, 2.0) == [False, False, True]


def test_pooled_results_whole_and_by_body_make_a_table() -> None:
    bodies = {"classic_bipedal": [20.0, 30.0], "fish": [0.0, 10.0], "climbing_chimpanzee": [5.0, 5.0]}
    halves = {body: [value / 2 for value in values] for body, values in bodies.items()}
    runs = pool(*parkour("alp_gmm", bodies), *parkour("random", halves))
    rows = [results_of(each) for each in (pooled(runs), pooled(runs, by=["embodiment"]))]
    (table,) = result_tables(TableResults(pd.concat(rows, ignore_index=True)))
    assert table.name == "parkour"
    assert table.cell("alp_gmm", "classic_bipedal").mean == 25
    assert table.cell("alp_gmm", "overall").n == 6
    assert table.cell("alp_gmm", "overall").best
    assert not table.cell("random", "overall").best


def test_a_root_becomes_tables_with_random_at_every_level(campaign: SyntheticCampaign) -> None:
    campaign.seeds("random", [2, 3], level="none")
    campaign.seeds("alp_gmm", [5, 6], half=0.2, level="high")
    table = tables_of_root(campaign.root)["original_space"]
    assert list(table.rows) == ["random", "alp_gmm"]
    assert table.cell("random", "high").mean == 25
    assert table.cell("alp_gmm", "high").best
    assert table.cell("alp_gmm", "none").missing == "not run"
    early = tables_of_root(campaign.root, step=500)["original_space"]
    assert early.cell("alp_gmm", "high").mean == 10
    assert "After 500 steps" in early.remarks[0]


def test_what_is_missing_of_a_pool_is_noted(campaign: SyntheticCampaign) -> None:
    campaign.seeds("alp_gmm", [5])
    campaign.run("alp_gmm", 1, "waiting")
    campaign.run("adr", 0, "waiting")
    table = tables_of_root(campaign.root)["original_space"]
    assert table.cell("alp_gmm", "low").missing == "not counted: 1 waiting"
    assert not table.cell("adr", "low").has_number
    assert "not counted: 1 waiting" in table.cell("adr", "low").missing
    assert "1 run each" in render(table, TableFormat.MARKDOWN)


def test_other_students_and_settings_have_tables_of_their_own(campaign: SyntheticCampaign) -> None:
    for student in ("sac", "ppo"):
        campaign.seeds("alp_gmm", [5], student=student, run_id=f"alp-{student}")
    campaign.seeds("alp_gmm", [5], physics_version=2, run_id="physics-2")
    for body in ("short_bipedal", "spider"):
        place = {"challenge": "diverse_students", "embodiment": body, "student": "ppo"}
        campaign.seeds("alp_gmm", [4], **place, run_id=f"diverse-{body}")
    tables = tables_of_root(campaign.root)
    assert {"original_space", "original_space-2", "challenges_low"} <= set(tables)
    assert tables["original_space"].cell("alp_gmm", "low").n == 1
    alone = next(table for name, table in tables.items() if name.startswith("challenges_low-ppo"))
    assert alone.cell("alp_gmm", "diverse_students").n == 2
    assert alone.cell("alp_gmm", "diverse_students").missing == ""
    assert "no results of" in tables["challenges_low"].cell("alp_gmm", "diverse_students").missing


def test_a_night_with_ppo_alone_is_no_gap_of_the_papers_students(campaign: SyntheticCampaign) -> None:
    campaign.seeds("alp_gmm", [5], student="ppo")
    (name,) = tables_of_root(campaign.root)
    assert name == "original_space-ppo"


def test_points_of_a_search_are_in_its_own_table_only(campaign: SyntheticCampaign) -> None:
    point = TEACHER_GRIDS["alp_gmm"].points()[1]
    campaign.experiment = "search_alp_gmm_01"
    campaign.seeds("alp_gmm", [5], level="none", spec=json.dumps({"teacher_hyperparameters": point}))
    assert tables_of_root(campaign.root) == {}
    text = write_tables(campaign.root).text
    assert f"ALP-GMM: mastered % | 1 of 64 points run | {DASH}<sup>" in text
    assert "| 50.0 |" in text
    assert "ALP-GMM: most\\_components | 5, 10, 15, 20 | 10 | 5 |" in text


def test_hyperparameters_and_needs_are_the_papers() -> None:
    table = hyperparameters()
    assert table.cell("adr.expand_at", "values").words == "180, 230, 280"
    assert table.cell("adr.expand_at", "chosen").words == "180"
    assert table.cell("spdl.first_update", "chosen").words == "200,000"
    needs = knowledge_needs()
    words = [needs.cell("goal_gan", column).words for column in needs.columns]
    assert words == ["optional", "ignored", "required"]


def test_an_empty_root_says_so(tmp_path: Path) -> None:
    SyntheticCampaign(tmp_path)
    written = write_tables(tmp_path)
    assert "This root holds no runs yet." in written.warnings
    assert any("original_space" in warning for warning in written.warnings)
    assert "Expert knowledge that teachers use" in written.text


@pytest.mark.parametrize("kind", TableFormat)
def test_each_table_is_a_file(tmp_path: Path, kind: TableFormat) -> None:
    written = write_tables("paper-2021", kind=kind.value, output=tmp_path / "tables")
    assert {path.stem for path in written.files} == {*BEST, "hyperparameters", "expert_knowledge"}
    text = "".join(path.read_text(encoding="utf-8") for path in written.files)
    assert text.replace("\n", "") == written.text.replace("\n", "")


@pytest.mark.parametrize(("root", "step"), [("paper-2021", 5), ("paper-2021", 0), ("nowhere-at-all", None)])
def test_what_there_is_not_is_refused(root: str, step: int | None) -> None:
    with pytest.raises(ValueError, match=r"leave out the step|expected at least 1|a results root"):
        write_tables(root, step)
