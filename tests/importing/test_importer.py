"""Folders of the original's results become a root that says what they said."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from release_folders import EPISODE, EPOCH, TESTS, Release, parkour, stumps

from analysis import load
from analysis.data.frames import Frames
from analysis.data.tables import evaluation_measures
from analysis.measures.pooling import pooled, runs_after
from analysis.tables.paper_tables import result_tables, table_results
from tma_ray.importing import ImportRefusedError, ImportSummary, import_results
from tma_ray.importing.names import CRITERIA, TEACHERS
from tma_ray.results import DATA_TABLES, Results, Table


def imported(release: Release, **options: Any) -> tuple[ImportSummary, Frames]:
    root = release.root.parent / "root"
    return import_results(release.root, root, **options), load(root)


def rows(frames: Frames, table: Table) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = frames.results.table(table).to_pylist()
    return found


def only(frames: Frames) -> pd.Series:
    (row,) = frames.cells.to_dict("records")
    return pd.Series(row)


def mastered(frames: Frames) -> list[float]:
    return evaluation_measures(frames.evaluations)["mastered_percent"].tolist()


def test_a_seed_of_sac(release: Release) -> None:
    folder = release.sac(stumps("ALP-GMM", 1, "minimal"), seed=3, mastered=[12, 34])
    done, frames = imported(release)
    cell = only(frames)
    assert (done.finished, done.unfinished, done.left_out, done.notes) == (1, {}, {}, {})
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge", "seed")
    assert [cell[name] for name in names] == [
        *("stump_tracks", "mostly_unfeasible", "old_classic_bipedal", "sac", "alp_gmm", "low", 3)
    ]
    assert (cell["engine"], cell["physics_version"], cell["steps"]) == ("Box2D", 0, 2 * EPOCH)
    assert (cell["status"], cell["test_set"]) == ("done", "box2d_stump_tracks")
    assert mastered(frames) == [12, 34]  # 230 itself is not mastered
    account = json.loads((release.root.parent / "root" / "imported.json").read_text())
    assert list(account["runs"].values()) == [folder.relative_to(release.root).as_posix()]


def test_every_number_of_the_books_is_where_it_belongs(release: Release) -> None:
    name = stumps("RIAC", 2)
    release.sac(name, mastered=[5, 60])
    history = release.history(name, 0, [EPOCH, 2 * EPOCH], [5, 60])
    _, frames = imported(release)
    evaluations = rows(frames, Table.EVALUATIONS)
    assert [row["step"] for row in evaluations] == [EPOCH] * TESTS + [2 * EPOCH] * TESTS
    assert [row["task_index"] for row in evaluations] == [*range(TESTS)] * 2
    assert [row["episodic_return"] for row in evaluations] == history["env_test_rewards"]
    assert [row["length"] for row in evaluations] == history["env_test_len"]
    assert np.array_equal([row["task"] for row in evaluations], history["env_params_test"])
    episodes = rows(frames, Table.EPISODES)
    assert np.array_equal([row["task"] for row in episodes], history["env_params_train"])
    assert [row["episodic_return"] for row in episodes] == history["env_train_rewards"]
    assert [row["step"] for row in episodes] == [EPISODE * (i + 1) for i in range(len(episodes))]
    assert [row["success"] for row in episodes] == [r > 230 for r in history["env_train_rewards"]]
    assert all(row["world_task"] is None for row in episodes)
    curriculum = rows(frames, Table.CURRICULUM)
    assert [row["step"] for row in curriculum] == [
        s for s in (500_000, 750_000, 1_000_000) for _ in range(100)
    ]
    assert np.array_equal(
        [row["task"] for row in curriculum], np.concatenate(history["periodical_samples"][1:])
    )


def test_training_windows_are_those_of_the_progress_file(release: Release) -> None:
    name = stumps("Random", 2)
    release.sac(name)
    returns = np.array(release.history(name, 0, [EPOCH, 2 * EPOCH], [1, 1])["env_train_rewards"]).reshape(
        2, -1
    )
    _, frames = imported(release)
    windows = pd.DataFrame(rows(frames, Table.TRAINING))
    assert windows["step"].tolist() == [EPOCH, 2 * EPOCH]
    assert windows["episodes"].tolist() == [EPOCH // EPISODE] * 2
    assert windows["mean_return"].tolist() == pytest.approx(returns.mean(axis=1))
    assert windows["std_return"].tolist() == pytest.approx(returns.std(axis=1))
    assert windows["mean_length"].tolist() == [EPISODE, EPISODE]
    assert windows["success_share"].tolist() == pytest.approx((returns > 230).mean(axis=1))


def test_a_seed_of_ppo_has_steps_of_its_own_and_its_seed_in_the_name(release: Release) -> None:
    release.ppo(stumps("ADR", 5, "maximal", "spider"), seed=17, mastered=[0, 7, 21])
    _, frames = imported(release)
    cell = only(frames)
    assert (cell["student"], cell["seed"], cell["embodiment"]) == ("ppo", 17, "spider")
    assert (cell["challenge"], cell["expert_knowledge"]) == ("diverse_students", "high")
    assert frames.evaluations["step"].unique().tolist() == [20_000, EPOCH, 2 * EPOCH]
    assert mastered(frames) == [0, 7, 21]
    assert frames.training["mean_return"].tolist() == [50, 51, 52]
    assert frames.training["std_return"].gt(0).all()  # the file has none: of the history' episodes


@pytest.mark.parametrize("label", TEACHERS)
def test_what_teachers_recorded_becomes_their_log(release: Release, label: str) -> None:
    release.sac(stumps(label, 3, "minimal"))
    done, frames = imported(release)
    log = rows(frames, Table.TEACHER_LOG)
    assert done.notes == {}
    if label == "Random":
        assert log == []
        return
    assert len(log) == 3
    steps = [200_000, 300_000, 400_000] if label == "Self-Paced" else [250_000, 500_000, 1_000_000]
    assert [row["step"] for row in log] == steps
    assert [row["episode"] for row in log] == [step // EPISODE for step in steps]
    shapes = {(len(row["gaussians"]), len(row["boxes"])) for row in log}
    expected = {
        "ALP-GMM": {(2, 0), (3, 0)},
        "Covar-GMM": {(2, 0), (3, 0)},
        "RIAC": {(0, 1), (0, 2), (0, 3)},
        "ADR": {(0, 1)},
        "Self-Paced": {(1, 0)},
    }
    assert shapes == expected.get(label, {(0, 0)})
    for gaussian in (each for row in log for each in row["gaussians"]):
        assert len(gaussian["mean"]) == 2
        assert np.shape(gaussian["covariance"]) == (2, 2)


def test_losses_and_divergences_keep_their_values(release: Release) -> None:
    release.sac(stumps("GoalGAN", 3, "minimal"))
    release.sac(stumps("Self-Paced", 3, "minimal"))
    _, frames = imported(release)
    scalars = [dict(row["scalars"]) for row in rows(frames, Table.TEACHER_LOG)]
    assert {"discriminator_loss": 0.4, "generator_loss": 2.0} in scalars
    assert {"iteration": 2.0, "kl": 4.0} in scalars


@pytest.mark.parametrize("number", range(1, 6))
def test_criteria_are_challenges(release: Release, number: int) -> None:
    release.sac(stumps("Random", number, "no", "small_bipedal" if number == 5 else ""))
    cell = only(imported(release)[1])
    assert cell["challenge"] == CRITERIA[number - 1]
    assert cell["embodiment"] == ("short_bipedal" if number == 5 else "old_classic_bipedal")


def test_the_body_that_ran_stands_in_the_tables_place_of_the_papers_bipedal(release: Release) -> None:
    bodies = ("old_classic_bipedal", "fish", "climbing_profile_chimpanzee")
    for seed, body in enumerate(bodies):
        release.sac(parkour("Random", body), seed=16 * seed, mastered=[0, 10 * seed])
    release.sac(stumps("Random", 1), mastered=[0, 20])
    (results,) = table_results(imported(release)[1])
    tables = {table.name: table for table in result_tables(results)}
    assert set(tables) == {"challenges_none", "parkour"}
    means = {column: cell.mean for (_, column), cell in tables["parkour"].cells.items()}
    assert means == {"old_classic_bipedal": 0, "fish": 10, "climbing_chimpanzee": 20, "overall": 10}
    assert tables["challenges_none"].cells["random", "mostly_unfeasible"].mean == 20


def test_an_upper_baseline_is_the_original_space(release: Release) -> None:
    release.sac("09-03_profiling_benchmark_stumps_UPPER_BASELINE_Covar-GMM_allow_expert_knowledge_maximal")
    cell = only(imported(release)[1])
    assert (cell["challenge"], cell["teacher"]) == ("original", "covar_gmm")


def test_folders_to_ignore_are_passed_by_and_said(release: Release) -> None:
    release.sac(stumps("RIAC", 1))
    release.sac(f"old_ignore/{stumps('RIAC', 2)}")
    release.sac(f"{stumps('RIAC', 4)}_IGNORE")
    done, frames = imported(release)
    assert len(frames.cells) == 1
    assert done.ignored == (f"{stumps('RIAC', 4)}_IGNORE", "old_ignore")


def test_experiments_lie_as_deep_as_they_like(release: Release) -> None:
    release.sac(f"a/b/{stumps('RIAC', 1)}")
    release.sac(f"{stumps('RIAC', 2)}/nested/{stumps('RIAC', 2)}", seed=1)
    done, frames = imported(release)
    assert done.finished == 2
    assert set(frames.cells["challenge"]) == {"mostly_unfeasible", "mostly_trivial"}


def test_the_source_may_be_one_experiment(release: Release) -> None:
    name = stumps("RIAC", 1)
    release.sac(name)
    root = release.root.parent / "root"
    assert import_results(release.root / name, root).finished == 1


def test_several_folders_of_one_cell_are_one_result(release: Release) -> None:
    release.sac(stumps("RIAC", 1, date="05-03"), seed=0, mastered=[0, 20])
    release.sac(stumps("RIAC", 1, date="06-03"), seed=1, mastered=[0, 40])
    _, frames = imported(release)
    (row,) = pooled(runs_after(frames, 1.0)).to_dict("records")
    assert (row["n"], row["mastered_percent_mean"], row["missing"]) == (2, 30, "")


def test_parkour_pools_its_bodies_though_each_has_its_tests(release: Release) -> None:
    for seed, body in enumerate(("old_classic_bipedal", "fish", "climbing_profile_chimpanzee")):
        release.sac(parkour("Random", body), seed=16 * seed, mastered=[0, 10 * seed])
    _, frames = imported(release)
    (row,) = pooled(runs_after(frames, 1.0)).to_dict("records")
    assert (row["n"], row["mastered_percent_mean"], row["missing"]) == (3, 10, "")
    assert row["test_sets"] == "box2d_parkour_climbing + box2d_parkour_swimming + box2d_parkour_walking"
    spec = json.loads(frames.cells["spec"].iloc[0])
    assert [d["name"] for d in spec["task_space"]][:4] == ["theta_1", "theta_2", "theta_3", "water_level"]
    assert (spec["task_space"][1]["low"], spec["task_space"][1]["high"]) == (0.6, 1.0)


def test_diverse_students_pool_bodies_and_students(release: Release) -> None:
    for body in ("small_bipedal", "spider"):
        release.sac(stumps("RIAC", 5, "no", body) + "_student_sac_v0.1.1", mastered=[0, 20])
        release.ppo(stumps("RIAC", 5, "no", body) + "_student_ppo", mastered=[0, 0, 40])
    _, frames = imported(release)
    (row,) = pooled(runs_after(frames, 1.0)).to_dict("records")
    assert (row["n"], row["mastered_percent_mean"], row["missing"]) == (4, 30, "")


def test_random_stands_at_every_level_of_its_others_as_one_run(release: Release) -> None:
    release.sac(stumps("Random", 1), mastered=[0, 20])
    for level in ("no", "minimal", "maximal"):
        release.sac(stumps("ALP-GMM", 1, level))
    _, frames = imported(release)
    cells = frames.cells[frames.cells["teacher"] == "random"]
    assert set(cells["expert_knowledge"]) == {"none", "low", "high"}
    assert cells["run_id"].nunique() == 1
    assert len(frames.results.runs()) == 4


def test_copies_of_randoms_files_are_one_run(release: Release) -> None:
    name, copy = stumps("Random", 1), stumps("Random", 1, "minimal")
    release.sac(name)
    folder = release.root / copy / f"{copy}_s0"
    folder.mkdir(parents=True)
    for path in (release.root / name / f"{name}_s0").iterdir():
        if path.is_file():
            (folder / path.name).write_bytes(path.read_bytes())
    done, frames = imported(release)
    assert done.finished == 1
    assert list(done.copies) == [f"{name}/{name}_s0"]  # the later one by name
    assert set(frames.cells["expert_knowledge"]) == {"none", "low"}


@pytest.mark.parametrize("protocol", [0, 3, 5])
def test_pickles_of_any_protocol_give_the_same_rows(release: Release, protocol: int) -> None:
    name = stumps("ALP-GMM", 1)
    release.evaluations = 1
    release.sac(name)
    other = Release(release.root.parent / "other", 1, protocol, "numpy._core")
    other.sac(name)
    tables = []
    for number, source in enumerate((release.root, other.root)):
        import_results(source, root := release.root.parent / f"root{number}")
        results = Results.open(root)
        tables.append([results.table(table).drop(["run_id"]).to_pylist() for table in DATA_TABLES])
    assert tables[0] == tables[1]


def test_importing_twice_gives_the_same_bytes(release: Release) -> None:
    release.evaluations = 1
    release.sac(stumps("ALP-GMM", 1))
    contents = []
    for number in range(2):
        root = release.root.parent / f"root{number}"
        import_results(release.root, root)
        files = (path for path in root.rglob("*") if path.is_file())
        contents.append({path.relative_to(root): path.read_bytes() for path in files})
    assert contents[0] == contents[1]


def test_a_place_with_files_is_refused_and_left_alone(release: Release, tmp_path: Path) -> None:
    release.sac(stumps("RIAC", 1))
    root = tmp_path / "root"
    root.mkdir()
    (root / "mine.txt").write_text("mine")
    with pytest.raises(ImportRefusedError, match=r"not empty.*mine\.txt"):
        import_results(release.root, root)
    assert [path.name for path in root.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("kind", ["missing", "empty", "a file", "all ignored"])
def test_a_source_without_seeds_is_refused_before_anything_is_written(
    release: Release, tmp_path: Path, kind: str
) -> None:
    source, root = tmp_path / "source", tmp_path / "root"
    if kind == "empty":
        source.mkdir()
    elif kind == "a file":
        source.write_text("")
    elif kind == "all ignored":
        source = release.root
        release.sac(f"ignore/{stumps('RIAC', 1)}")
    with pytest.raises(ImportRefusedError, match=r"source|release"):
        import_results(source, root)
    assert not root.exists()
