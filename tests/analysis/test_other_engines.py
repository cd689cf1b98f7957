"""Runs of another engine are never pooled or tested with ours."""

import itertools
import json
from collections.abc import Mapping
from pathlib import Path

import pytest

from analysis import load
from analysis.baselines import Baseline
from analysis.baselines import release as pack
from analysis.comparisons.frame import against_baseline, pairwise
from analysis.comparisons.sentences import ranking
from analysis.comparisons.sides import baseline_side, beside, duels, side_of, together
from analysis.data.frames import GROUP, Frames
from analysis.measures.evaluations import evaluation_curves, final_evaluations
from analysis.measures.pooling import POOLED, pooled, runs_after
from analysis.tables.paper_tables import table_results
from tma_ray.results import (
    BOX2D,
    BOX2D_TEST_SET,
    CHIPMUNK,
    NO_PHYSICS_VERSION,
    Committer,
    RunRecord,
    RunWriter,
    Store,
    Table,
)
from tma_ray.runs import RunSpec

pytestmark = pytest.mark.slow

NAMES = {
    "environment": "stump_tracks",
    "challenge": "mostly_unfeasible",
    "embodiment": "classic_bipedal",
    "student": "sac",
    "expert_knowledge": "none",
}
STEPS = 1_000_000


def add_runs(root: Path, engine: str, mastered: Mapping[str, int]) -> None:
    """Add three runs of each teacher; a run masters as many tasks as `mastered` says, plus its seed."""
    ours = engine == CHIPMUNK
    test_set = "stump_tracks" if ours else f"{BOX2D_TEST_SET}stump_tracks"
    committer = Committer(Store.open(root))
    cells = []
    for teacher, seed in itertools.product(mastered, range(3)):
        names = NAMES | {"teacher": teacher}
        record = RunRecord(
            f"{engine.lower()}-{teacher}-{seed}",
            "{}" if ours else json.dumps({"engine": engine}),
            **names,
            test_set=test_set,
            steps=STEPS,
            seed=seed,
            physics_version=1 if ours else NO_PHYSICS_VERSION,
        )
        attempt = committer.start(record)
        writer = RunWriter(committer.store, record.run_id, attempt)
        rows = [
            {"step": STEPS, "test_set": test_set, "task_index": i, "task": [float(i), 0.0]}
            | {"episodic_return": 300.0 if i < mastered[teacher] + seed else 0.0, "length": 1}
            for i in range(100)
        ]
        writer.add(Table.EVALUATIONS, rows)
        committer.finish(record, attempt, writer.finish())
        cells.append(names | {"seed": seed, "run_id": record.run_id, "experiment": "mostly_unfeasible"})
    committer.write_cells(engine, cells)


@pytest.fixture
def box2d(tmp_path: Path) -> Path:
    add_runs(tmp_path / "box2d", BOX2D, {"random": 10, "riac": 40})
    return tmp_path / "box2d"


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    add_runs(tmp_path / "ours", CHIPMUNK, {"random": 20, "riac": 30})
    return tmp_path / "ours"


@pytest.fixture
def mixed(box2d: Path) -> Frames:
    """Both in one root, under one name of an experiment, with the same steps."""
    add_runs(box2d, CHIPMUNK, {"random": 20, "riac": 30})
    return load(box2d)


def test_a_ranking_of_a_mixed_root_pools_and_tests_engines_apart(mixed: Frames) -> None:
    table = ranking(mixed, measure="mastered_percent").set_index(["engine", "teacher"])
    assert table["mastered_percent_mean"].to_dict() == {
        ("Box2D", "random"): 11,
        ("Box2D", "riac"): 41,
        ("Chipmunk", "random"): 21,
        ("Chipmunk", "riac"): 31,
    }
    assert set(table["n"]) == {3}
    assert table.loc[("Box2D", "riac"), "difference"] == 30
    assert table.loc[("Chipmunk", "riac"), "difference"] == 10
    assert any("different engines (Box2D, Chipmunk)" in warning for warning in mixed.warnings)


def test_no_pair_is_tested_across_engines(mixed: Frames) -> None:
    runs = runs_after(mixed, 1.0)
    tests = pairwise(runs, "mastered_percent")
    assert sorted(tests["engine"]) == ["Box2D", "Chipmunk"]
    assert "engine" in POOLED
    assert set(pooled(runs)["engine"]) == {"Box2D", CHIPMUNK}


@pytest.mark.slow
def test_reports_and_tables_keep_them_apart(mixed: Frames) -> None:
    assert "engine" in GROUP
    finals = final_evaluations(mixed)
    tests = against_baseline(finals, evaluation_curves(mixed), "mastered_percent")
    assert dict(zip(tests["engine"], tests["difference"], strict=True)) == {"Box2D": 30, "Chipmunk": 10}
    remarks = [results.remark for results in table_results(mixed)]
    assert sorted(remarks) == [
        "After 1 million steps, physics version 1.",
        "After 1 million steps, worlds of Box2D.",
    ]


def test_as_a_baseline_they_stand_beside_ours(box2d: Path, ours: Path) -> None:
    mine, theirs = side_of(load(ours), "ours"), baseline_side(str(box2d))
    assert (mine.engine, theirs.engine) == ("Chipmunk, physics version 1", "Box2D")
    runs = together(mine, [theirs])
    assert set(runs["source"]) == {"ours"}
    assert set(duels(runs, ["riac"])["second"]) == {"random"}
    shown = beside(mine, theirs)
    assert shown["teacher"].tolist() == ["random", "riac"]
    assert all("engine: Box2D" in text for text in shown["differs"])


def test_a_release_of_them_says_whose_worlds_they_are(box2d: Path, tmp_path: Path) -> None:
    baseline = Baseline.open(pack(box2d, "theirs", tmp_path, "CC0-1.0"))
    assert (baseline.manifest.engine, baseline.manifest.physics_versions) == ("Box2D", ())
    assert "in worlds of Box2D" in (tmp_path / "theirs" / "README.md").read_text()


def test_a_run_of_another_engine_cannot_be_run_again(box2d: Path) -> None:
    spec = json.loads(load(box2d).cells["spec"].iloc[0])
    with pytest.raises(ValueError, match="Box2D simulated its worlds"):
        RunSpec.from_dict(spec)
