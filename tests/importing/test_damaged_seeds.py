"""One bad seed is named with its reason and never loses the rest."""

import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_pickles import shell
from release_folders import EPOCH, TESTS, Release, stumps

from analysis import load
from tma_ray.importing import ImportRefusedError, import_results
from tma_ray.results import RunStatus, Table

pytestmark = pytest.mark.slow

NAME = stumps("ALP-GMM", 1)
BAD = f"{NAME}/{NAME}_s1"


def change_history(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "env_params_save.pkl"
    history = pickle.loads(path.read_bytes())
    change(history)
    path.write_bytes(pickle.dumps(history))


def cut_returns(history: dict[str, Any]) -> None:
    for name in ("env_test_rewards", "env_test_len", "env_params_test"):
        del history[name][-30:]


def shorten(history: dict[str, Any]) -> None:
    for name in ("env_params_train", "env_train_rewards", "env_train_len"):
        del history[name][200:]


def replace(name: str, old: str, new: str) -> Callable[[Path], object]:
    return lambda folder: (folder / name).write_text((folder / name).read_text().replace(old, new))


def history(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], object]:
    return lambda folder: change_history(folder, change)


def truncate(folder: Path) -> None:
    path = folder / "env_params_save.pkl"
    path.write_bytes(path.read_bytes()[:-500])


def poison(folder: Path) -> None:
    (folder / "env_params_save.pkl").write_bytes(shell(str(folder / "trace")))


LEFT_OUT: dict[str, tuple[Callable[[Path], object], str]] = {
    "no pickle": (lambda f: (f / "env_params_save.pkl").unlink(), r"env_params_save\.pkl is missing: copy"),
    "pickle cut off": (truncate, r"env_params_save\.pkl was refused.*cut off"),
    "hostile pickle": (poison, r"env_params_save\.pkl was refused.*system"),
    "no configuration": (lambda f: (f / "config.json").unlink(), r"config\.json is missing.*steps_per_epoch"),
    "configuration cut off": (lambda f: (f / "config.json").write_text("{"), r"config\.json cannot be read"),
    "no seed": (replace("config.json", '"seed": 1', '"seed": null'), "seed: expected a whole number"),
    "no progress": (lambda f: (f / "progress.txt").unlink(), r"neither progress\.txt nor progress\.csv"),
    "empty progress": (lambda f: (f / "progress.txt").write_text(""), r"progress\.txt has no column Epoch"),
    "header alone": (replace("progress.txt", "\n1\t", "\n"), r"progress\.txt"),
    "other columns": (replace("progress.txt", "EpLen", "Len"), r"progress\.txt has no column EpLen"),
    "word for a number": (replace("progress.txt", "\n1\t", "\none\t"), r"progress\.txt, line 2: expected 13"),
    "steps that fall": (replace("progress.txt", "\n2\t", "\n1\t"), "steps do not rise"),
    "evaluation cut off": (history(cut_returns), r"170 returns.*2 evaluations: one is cut off; copy both"),
    "unequal lengths": (
        history(lambda b: b["env_train_len"].pop()),
        "500 tasks, 500 returns and 499 lengths",
    ),
    "history of another training": (history(shorten), r"not of one training; copy both again"),
    "tasks of other size": (
        history(lambda b: b.update(env_params_train=[np.zeros(3)] * 500)),
        r"env_params_train is not a list of tasks of 2 finite numbers",
    ),
    "objects for numbers": (
        history(lambda b: b.update(env_test_rewards=[{}])),
        "env_test_rewards is not a list",
    ),
    "no returns": (
        history(lambda b: b.pop("env_train_rewards")),
        "env_train_rewards is not a list",
    ),
    "return that is not a number": (
        history(lambda b: b["env_test_rewards"].__setitem__(0, float("nan"))),
        "is not a finite number",
    ),
    "length that is not a number of steps": (
        history(lambda b: b["env_train_len"].__setitem__(0, -3)),
        "is not a whole number of steps",
    ),
    "the same long list again and again": (
        history(lambda b: b.update(env_params_train=[[0.0] * 100_000] * 100_000)),
        "env_params_train is not a list of tasks",
    ),
    "list for history": (
        lambda f: (f / "env_params_save.pkl").write_bytes(pickle.dumps([1])),
        "does not hold a teacher history",
    ),
}


def test_damaged_seeds_are_left_out_each_with_its_reason(release: Release, tmp_path: Path) -> None:
    release.sac(NAME, seed=0, mastered=[1, 2])
    reasons = {}
    for number, (damage, reason) in enumerate(LEFT_OUT.values()):
        experiment = stumps("ALP-GMM", 1, date=f"01-{number:02}")
        damage(release.sac(experiment, seed=1))
        reasons[f"{experiment}/{experiment}_s1"] = reason
    done = import_results(release.root, tmp_path / "root")
    assert done.finished == 1
    assert set(done.left_out) == set(reasons)
    for kind, (folder, reason) in zip(LEFT_OUT, reasons.items(), strict=True):
        assert re.search(reason, done.left_out[folder], re.DOTALL), f"{kind}: {done.left_out[folder]}"
    assert load(tmp_path / "root").cells["seed"].tolist() == [0]
    assert set(json.loads((tmp_path / "root" / "imported.json").read_text())["left_out"]) == set(reasons)
    assert not list(release.root.rglob("trace"))


def test_a_last_line_that_was_not_finished_leaves_whole_evaluations(release: Release, tmp_path: Path) -> None:
    release.sac(NAME, seed=0)
    path = release.sac(NAME, seed=1, mastered=[11, 12]) / "progress.txt"
    path.write_text(path.read_text()[:-40])
    done = import_results(release.root, tmp_path / "root")
    assert "last line of its progress file is not whole" in done.unfinished[BAD]
    assert "ends after 500,000 of 1,000,000 steps" in done.unfinished[BAD]
    frames = load(tmp_path / "root")
    (run,) = [run for run in frames.results.runs() if run.run.seed == 1]
    assert run.status is RunStatus.FAILED
    assert str(run.error).startswith("imported unfinished")
    kept = frames.evaluations[frames.evaluations["run_id"] == run.run.run_id]
    assert (len(kept), kept["step"].unique().tolist(), int(kept["mastered"].sum())) == (TESTS, [EPOCH], 11)
    episodes = frames.results.table(Table.EPISODES, [run.run.run_id]).to_pylist()
    assert max(row["step"] for row in episodes) == EPOCH


def test_a_seed_that_stopped_early_is_unfinished(release: Release, tmp_path: Path) -> None:
    release.sac(NAME, seed=0)
    release.evaluations = 1
    release.sac(NAME, seed=1)
    done = import_results(release.root, tmp_path / "root")
    assert done.unfinished == {BAD: "it ends after 500,000 of 1,000,000 steps"}
    cells = load(tmp_path / "root").cells.set_index("seed")
    assert cells["status"].to_dict() == {0: "done", 1: "failed"}
    assert cells["steps"].tolist() == [2 * EPOCH] * 2


def test_a_progress_file_shorter_than_its_books_is_imported_as_far_as_both_go(
    release: Release, tmp_path: Path
) -> None:
    release.sac(NAME, seed=0)
    path = release.sac(NAME, seed=1) / "progress.txt"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    done = import_results(release.root, tmp_path / "root")
    assert "its progress file has 1 evaluations and its teacher history has 2" in done.unfinished[BAD]
    frames = load(tmp_path / "root")
    (run,) = [run.run.run_id for run in frames.results.runs() if run.run.seed == 1]
    assert len(frames.results.table(Table.EVALUATIONS, [run])) == TESTS
    assert max(frames.episode_returns([run])["step"]) == EPOCH


def test_a_budget_in_the_configuration_counts(release: Release, tmp_path: Path) -> None:
    folder = release.sac(NAME, seed=0)
    config = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps(config | {"epochs": 40}))
    done = import_results(release.root, tmp_path / "root")
    assert list(done.unfinished.values()) == ["it ends after 1,000,000 of 20,000,000 steps"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("05-03_profiling_benchmark_stumps_ALP-GMM_allow_expert_knowledge_no", "no challenge in it"),
        ("05-03_profiling_benchmark_stumps_ALP-GMM_criteria_6_allow_expert_knowledge_no", "no challenge"),
        ("05-03_profiling_benchmark_stumps_ALP-GMM_criteria_1", "no level of expert knowledge in it"),
        ("05-03_profiling_benchmark_stumps_ALP-GMM_criteria_1_allow_expert_knowledge_some", "is none of no"),
        ("05-03_profiling_benchmark_stumps_ALP-GMM_criteria_5_allow_expert_knowledge_no", "no body in it"),
        ("05-03_benchmark_parkour_RIAC_walker_type_unicorn", "walker_type is none of"),
        (
            "05-03_profiling_benchmark_stumps_Mine_criteria_1_allow_expert_knowledge_no",
            "names its experiment",
        ),
        (f"{NAME}_student_ppo", "says student ppo, and its progress file is that of sac"),
    ],
)
def test_a_folder_whose_name_does_not_say_enough(
    release: Release, tmp_path: Path, name: str, reason: str
) -> None:
    release.sac(NAME)
    release.sac(name)
    done = import_results(release.root, tmp_path / "root")
    assert done.finished == 1
    (told,) = done.left_out.values()
    assert reason in told


def test_a_seed_of_ppo_without_its_number(release: Release, tmp_path: Path) -> None:
    release.sac(NAME)
    folder = release.ppo(NAME, seed=1)
    folder.rename(folder.with_name("anyhow"))
    done = import_results(release.root, tmp_path / "root")
    assert "does not end with _s and the seed" in done.left_out[f"{NAME}/anyhow"]


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (lambda b: b["episodes"].pop(), "teacher's log was left out: its entries do not fit together"),
        (lambda b: b.update(means=[np.zeros(1)] * 3), "teacher's log was left out: weights, means"),
        (lambda b: b.update(weights=None), "teacher's log was left out: weights is not there"),
        (lambda b: b.update(periodical_samples="none"), "its probes were left out"),
        (lambda b: b.update(periodical_samples=[[[0.0, 0.0]] * 10_000] * 10_000), "its probes were left out"),
        (lambda b: b.update(weights=[*[[0.5] * 3_000] * 3_000]), "more entries than a training"),
        (lambda b: b.update(env_param_bounds=[("mu_h", "wide")]), "its task space is unknown"),
    ],
)
def test_what_a_teacher_recorded_may_be_damaged_without_its_results(
    release: Release, tmp_path: Path, change: Callable[[dict[str, Any]], object], note: str
) -> None:
    change_history(release.sac(NAME, mastered=[1, 2]), change)
    done = import_results(release.root, tmp_path / "root")
    assert done.finished == 1
    (notes,) = done.notes.values()
    assert note in notes[0]
    assert load(tmp_path / "root").evaluations["mastered"].sum() == 3


def test_nothing_is_written_where_no_seed_is_whole(release: Release, tmp_path: Path) -> None:
    truncate(release.sac(NAME))
    with pytest.raises(ImportRefusedError, match=r"no seed of .* can be imported.*env_params_save\.pkl"):
        import_results(release.root, tmp_path / "root")
    assert not (tmp_path / "root").exists()
