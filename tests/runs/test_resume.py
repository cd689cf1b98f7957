"""A run interrupted and resumed gives the files, bit for bit, of one that was not."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from small_runs import data_files, rows, run, small_spec, stump_tracks_spec

from tma_ray.results import Store, Table
from tma_ray.runs import Placement, RunSpec

HERE = Path(__file__).parent


def finish_in_a_new_process(spec: RunSpec, folder: Path) -> None:
    (folder / "spec.json").write_text(json.dumps(spec.to_dict()))
    command = [sys.executable, "small_runs.py", str(folder / "spec.json"), str(folder / "resumed")]
    subprocess.run(command, cwd=HERE, check=True)


@pytest.mark.parametrize(
    ("student", "teacher"),
    [
        ("ppo", "random"),
        ("ppo", "alp_gmm"),
        ("ppo", "odd_teachers:Scrutinising"),
        ("ppo", "goal_gan"),
        ("sac", "random"),
        ("sac", "alp_gmm"),
        ("sac", "spdl"),
        ("sac", "setter_solver"),
    ],
)
def test_many_episodes_stopped_twice_and_finished_in_a_new_process(
    tmp_path: Path, student: str, teacher: str
) -> None:
    spec = small_spec(tmp_path, student, teacher)
    run(spec, tmp_path / "undisturbed")
    assert run(spec, tmp_path / "resumed", stop_after=37) == "stopped"
    assert run(spec, tmp_path / "resumed", stop_after=41) == "stopped"
    finish_in_a_new_process(spec, tmp_path)
    undisturbed = data_files(tmp_path / "undisturbed")
    assert len(undisturbed) == 5
    assert data_files(tmp_path / "resumed") == undisturbed
    assert (len(rows(tmp_path / "resumed", Table.TEACHER_LOG)) > 3) == (teacher != "random")


@pytest.mark.parametrize(("student", "teacher"), [("ppo", "alp_gmm"), ("sac", "random")])
def test_stump_tracks_stopped_and_finished_in_a_new_process(
    tmp_path: Path, student: str, teacher: str
) -> None:
    spec = stump_tracks_spec(tmp_path, student, teacher)
    run(spec, tmp_path / "undisturbed")
    assert run(spec, tmp_path / "resumed", stop_after=2) == "stopped"
    finish_in_a_new_process(spec, tmp_path)
    assert data_files(tmp_path / "resumed") == data_files(tmp_path / "undisturbed")


def test_checkpoints_at_every_episode_change_nothing(tmp_path: Path) -> None:
    spec = small_spec(tmp_path, teacher="alp_gmm", steps=1_000)
    run(spec, tmp_path / "few")
    run(spec, tmp_path / "many", placement=Placement(checkpoint_seconds=0.0))
    assert data_files(tmp_path / "many") == data_files(tmp_path / "few")
    assert not list((tmp_path / "many" / "checkpoints").rglob("*.*")), "checkpoints go when the run has ended"


@pytest.mark.parametrize("damage", ["flip", "truncate", "no_index", "garbage_index"])
def test_a_damaged_checkpoint_falls_back_to_the_one_before(tmp_path: Path, damage: str) -> None:
    spec = small_spec(tmp_path)
    run(spec, tmp_path / "undisturbed")
    root = tmp_path / "damaged"
    assert run(spec, root, stop_after=12, placement=Placement(checkpoint_seconds=0.0)) == "stopped"
    folders = sorted((root / "checkpoints" / spec.run_id).iterdir())
    assert len(folders) == 2
    newest = folders[-1]
    if damage == "flip":
        state = newest / "run.pickle"
        state.write_bytes(state.read_bytes()[:-1] + b"x")
    elif damage == "truncate":
        state = newest / "run.pickle"
        state.write_bytes(state.read_bytes()[: state.stat().st_size // 2])
    elif damage == "no_index":
        (newest / "index.json").unlink()
    else:
        (newest / "index.json").write_text("{")
    assert run(spec, root) == "done"
    assert data_files(root) == data_files(tmp_path / "undisturbed")


def test_rows_of_an_attempt_after_its_last_checkpoint_are_not_published(tmp_path: Path) -> None:
    """A killed process may leave parts that no checkpoint knows: they are played again, not doubled."""
    spec = small_spec(tmp_path)
    run(spec, tmp_path / "undisturbed")
    root = tmp_path / "killed"
    run(spec, root, stop_after=12, placement=Placement(checkpoint_seconds=0.0))
    newest = sorted((root / "checkpoints" / spec.run_id).iterdir())[-1]
    Store.open(root).delete(newest.relative_to(root).as_posix())
    assert run(spec, root) == "done"
    assert data_files(root) == data_files(tmp_path / "undisturbed")


def test_a_reader_sees_whole_evaluations_while_the_run_stands(tmp_path: Path) -> None:
    spec = small_spec(tmp_path)
    run(spec, tmp_path / "root", stop_after=15)
    evaluations = rows(tmp_path / "root", Table.EVALUATIONS)
    steps = sorted({row["step"] for row in evaluations})
    assert steps[0] == 0
    assert len(evaluations) == 3 * len(steps)
    episodes = rows(tmp_path / "root", Table.EPISODES)
    assert [row["episode"] for row in episodes] == list(range(15))
