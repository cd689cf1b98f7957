"""A run interrupted and resumed gives the files, bit for bit, of one that was not."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from cohort_in_a_thread import serving
from small_runs import SCHEDULE, STUDENTS, data_files, rows, run, short_run, small_spec, stump_tracks_spec

from tma_ray.results import Table
from tma_ray.runs import Cell, Placement, RunSpec, Schedule, effective_spec

HERE = Path(__file__).parent
Case = tuple[str, str, str]
RunAndFolder = tuple[RunSpec, Path]

CASES: tuple[Case, ...] = (
    *(
        ("corridor", student, name)
        for student in ("ppo", "sac")
        for name in ("alp_gmm", "odd_teachers:Examining")
    ),
    ("corridor", "ppo", "odd_teachers:Scrutinising"),
    ("corridor", "sac", "spdl"),
    ("stump_tracks", "ppo", "alp_gmm"),
    ("stump_tracks", "sac", "random"),
)
"""Every teacher with both students is killed among the tests of chaos."""

WORLDS = {"corridor": (small_spec, 2_000, (37, 11)), "stump_tracks": (stump_tracks_spec, 3_000, (2,))}
"""How specs are made, steps, and the episodes after which a run is stopped."""


def stopped_run(folder: Path, case: Case) -> RunSpec:
    """Begin a run of `case`, and stop it as often as its world says."""
    world, student, teacher = case
    make, steps, stops = WORLDS[world]
    spec = make(folder, student, teacher, steps=steps, evaluation_interval=steps // 2)
    for stop in stops:
        assert run(spec, folder / "resumed", stop_after=stop) == "stopped"
    return spec


def assert_resumed_as_undisturbed(spec: RunSpec, folder: Path) -> None:
    run(spec, folder / "undisturbed")
    undisturbed = data_files(folder / "undisturbed")
    assert len(undisturbed) == 5
    assert data_files(folder / "resumed") == undisturbed


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> dict[Case, RunAndFolder]:
    """Run that were stopped, and then all finished in one new process."""
    runs = {}
    for case in CASES:
        folder = tmp_path_factory.mktemp("-".join(case[:2]))
        runs[case] = stopped_run(folder, case), folder
        (folder / "spec.json").write_text(json.dumps(runs[case][0].to_dict()))
    folders = [str(folder) for _, folder in runs.values()]
    subprocess.run([sys.executable, "small_runs.py", *folders], cwd=HERE, check=True)
    return runs


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids="-".join)
def test_stopped_and_finished_in_a_new_process(finished: dict[Case, RunAndFolder], case: Case) -> None:
    """Many short episodes, stopped twice; or few long ones."""
    spec, folder = finished[case]
    assert_resumed_as_undisturbed(spec, folder)
    if case[0] == "corridor":
        assert len(rows(folder / "resumed", Table.TEACHER_LOG)) > 3


def test_stopped_and_finished_with_all_that_a_teacher_may_ask_for(tmp_path: Path) -> None:
    spec = stopped_run(tmp_path, ("corridor", "ppo", "odd_teachers:Examining"))
    assert run(spec, tmp_path / "resumed") == "done"
    assert_resumed_as_undisturbed(spec, tmp_path)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunSpec, dict[str, bytes]]:
    """A short run, and the files that it gives undisturbed."""
    return short_run(tmp_path_factory.mktemp("short"))


def test_checkpoints_change_nothing(tmp_path: Path, short: tuple[RunSpec, dict[str, bytes]]) -> None:
    spec, undisturbed = short
    run(spec, tmp_path, placement=Placement(checkpoint_seconds=0.0))
    assert data_files(tmp_path) == undisturbed
    assert not list((tmp_path / "checkpoints").rglob("*.*")), "checkpoints go when the run has ended"


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory, short: tuple[RunSpec, dict[str, bytes]]) -> Path:
    """The root of the short run, stopped halfway with a checkpoint after every episode."""
    root = tmp_path_factory.mktemp("stopped") / "root"
    assert run(short[0], root, stop_after=30, placement=Placement(checkpoint_seconds=0.0)) == "stopped"
    return root


def rewrite(file: Path, change: Callable[[bytes], bytes]) -> None:
    file.write_bytes(change(file.read_bytes()))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "state flipped": lambda newest: rewrite(newest / "run.pickle", lambda data: data[:-1] + b"x"),
    "state truncated": lambda newest: rewrite(newest / "run.pickle", lambda data: data[: len(data) // 2]),
    "index removed": lambda newest: (newest / "index.json").unlink(),
    "index truncated": lambda newest: (newest / "index.json").write_text("{"),
    "index leads out": lambda new: rewrite(new / "index.json", lambda d: d.replace(b'"run.', b'"../run.')),
    "removed": shutil.rmtree,
}
"""Of the newest checkpoint; without it, rows are left of which no checkpoint knows."""


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_checkpoint_falls_back_to_the_one_before(tmp_path, short, stopped, damage):
    spec, undisturbed = short
    root = shutil.copytree(stopped, tmp_path / "damaged")
    _, newest = sorted((root / "checkpoints" / spec.run_id).iterdir())
    shutil.copy(newest / "run.pickle", newest.parent)  # where an index may lead to
    DAMAGE[damage](newest)
    assert run(spec, root) == "done"
    assert data_files(root) == undisturbed


def test_a_reader_sees_whole_evaluations_while_the_run_stands(tmp_path: Path) -> None:
    spec = small_spec(tmp_path)
    run(spec, tmp_path / "root", stop_after=15)
    evaluations = rows(tmp_path / "root", Table.EVALUATIONS)
    steps = sorted({row["step"] for row in evaluations})
    assert steps[0] == 0
    assert len(evaluations) == 3 * len(steps)
    episodes = rows(tmp_path / "root", Table.EPISODES)
    assert [row["episode"] for row in episodes] == list(range(15))


WIDTH = 3


def forgetting(folder: Path, student: str) -> RunSpec:
    """Return a run whose student forgets twice, under a teacher that trains networks of its own."""
    spec = small_spec(folder, student, "goal_gan")
    return replace(spec, resets=(SCHEDULE.steps // 3, 2 * SCHEDULE.steps // 3))


def asking(folder: Path, student: str) -> RunSpec:
    """Return a run whose teacher asks for values of states."""
    return small_spec(folder, student, "spdl")


def examining(folder: Path, student: str) -> RunSpec:
    """Return a run whose teacher has tasks played without learning, and asks for evaluations."""
    return small_spec(folder, student, "odd_teachers:Examining", steps=1_500)


def swimming(folder: Path, student: str) -> RunSpec:
    """Return a run of a fish in Parkour."""
    return _walk(folder, student, "parkour", "easy_swimming", "fish")


def diverse(folder: Path, student: str) -> RunSpec:
    """Return a run of a body with other observations and actions."""
    return _walk(folder, student, "stump_tracks", "diverse_students", "spider")


def _walk(folder: Path, student: str, environment: str, challenge: str, body: str) -> RunSpec:
    del folder
    values = {**STUDENTS[student], **({"steps_per_update": 200} if student == "ppo" else {})}
    cell = Cell(environment, challenge, body, student, "random", student_hyperparameters=values)
    return effective_spec(cell, 0, Schedule(2_000, 1_000_000, 1_000, 5, 1_000))


@pytest.mark.slow
@pytest.mark.parametrize("student", ["ppo", "sac"])
@pytest.mark.parametrize("kind", [forgetting, asking, examining, swimming, diverse])
def test_an_interrupted_run_is_bit_for_bit_one_that_was_not(tmp_path, student, kind):
    """First alone in its cohort; then stopped, and resumed beside another learner's other run."""
    spec = kind(tmp_path, student)
    with serving(tmp_path, WIDTH) as learner:
        assert run(spec, tmp_path / "whole", placement=Placement(learner=learner)) == "done"
    neighbour = replace(spec, seed=1)
    for name, stop_after in (("first", 2), ("second", None)):
        (tmp_path / name).mkdir()
        with serving(tmp_path / name, WIDTH) as learner:
            placement = Placement(learner=learner)
            run(neighbour, tmp_path / "neighbour", 1, placement)
            run(spec, tmp_path / "resumed", stop_after, placement)
    assert data_files(tmp_path / "resumed") == data_files(tmp_path / "whole")
