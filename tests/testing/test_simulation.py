import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from analysis.commands import simulated
from tma_ray.cli import main
from tma_ray.tasks import KnowledgeLevel
from tma_ray.testing import SIMULATED_CHALLENGES, SimulatedChallenge, Simulation, matrix, simulate
from tma_ray.testing import find_simulated_challenge as find
from tma_ray.testing.simulation import EVALUATIONS

NONE, LOW, HIGH = KnowledgeLevel
EPISODES = 400


@pytest.mark.parametrize("challenge", SIMULATED_CHALLENGES, ids=lambda challenge: challenge.name)
def test_every_challenge_fits_together(challenge: SimulatedChallenge) -> None:
    space = challenge.task_space
    challenge.tests().check(space)
    assert challenge.tests().dimensions == space.names
    assert space.contains(challenge.easy_task)
    assert space.contains(challenge.hard_task)
    assert len(simulate(challenge, "random", episodes=EPISODES).curve) == EVALUATIONS


def test_challenges_mirror_the_paper() -> None:
    """Appendix C: what share of the tasks a classic walker can do, and what is flat ground."""
    rng = np.random.default_rng(0)
    unfeasible, trivial = find("mostly_unfeasible"), find("mostly_trivial")
    simulation = Simulation(unfeasible, "random", NONE, 0)
    tasks = unfeasible.task_space.sample(rng, 4000)
    simulation.student._competence[:] = 1.0  # a student that can do all there is to do
    feasible = np.mean(simulation.student.expected_returns(tasks) > -100)
    assert 0.2 < feasible < 0.3
    assert np.mean(trivial.task_space.sample(rng, 4000)[:, 0] <= 0) == pytest.approx(0.5, abs=0.03)
    assert find("forgetting_student").resets == (0.35, 0.7)
    assert len(find("diverse_students").aptitudes) == 4
    with pytest.raises(ValueError, match="did you mean 'rugged_difficulty'"):
        find("ruged_difficulty")


def test_a_run_is_determined_by_its_seed() -> None:
    first, again, other = (simulate(find("mostly_trivial"), "riac", seed=s, episodes=1500) for s in (0, 0, 1))
    assert first == again
    assert first.curve != other.curve


def test_all_teachers_of_a_seed_meet_the_same_world_and_student() -> None:
    rugged = find("rugged_difficulty")
    first, second = (Simulation(rugged, teacher, NONE, 3) for teacher in ("random", "alp_gmm"))
    assert first.landscape is not None
    assert second.landscape is not None
    np.testing.assert_array_equal(first.landscape.order, second.landscape.order)
    np.testing.assert_array_equal(first.teacher.knowledge.initial.mean, second.teacher.knowledge.initial.mean)
    assert [first.student.play([0, 6]) for _ in range(5)] == [second.student.play([0, 6]) for _ in range(5)]


def test_the_expert_of_a_rugged_space_points_at_the_easy_task() -> None:
    rugged = find("rugged_difficulty")
    for seed in range(4):
        simulation = Simulation(rugged, "alp_gmm", HIGH, seed)
        assert simulation.landscape is not None
        told = simulation.teacher.knowledge.initial.mean
        np.testing.assert_allclose(simulation.landscape.to_world(told), rugged.easy_task, atol=1e-5)


def test_diverse_students_come_in_turn() -> None:
    diverse = find("diverse_students")
    limits = [Simulation(diverse, "random", NONE, seed).student.aptitude.limit for seed in range(8)]
    assert limits == [0.5, 0.5, 0.7, 0.7] * 2


def test_episodes_are_what_a_run_would_report() -> None:
    simulation = Simulation(find("original"), "random", NONE, 0)
    episodes = [simulation.advance() for _ in range(300)]
    assert [episode.step for episode in episodes] == [2000 * (index + 1) for index in range(300)]
    assert all(episode.success == (episode.episodic_return > 230) for episode in episodes)
    discounted = [episode.discounted_return / episode.episodic_return for episode in episodes]
    np.testing.assert_allclose(discounted, 0.05, rtol=1e-3)


def test_a_reset_student_has_forgotten_at_the_next_evaluation() -> None:
    quick = replace(find("forgetting_student").aptitudes[0], pace=0.8)
    forgetting = replace(find("forgetting_student"), aptitudes=(quick,))
    kept = simulate(replace(forgetting, resets=()), "random", episodes=2000).curve
    reset = simulate(forgetting, "random", episodes=2000).curve
    assert reset[:7] == kept[:7]
    assert kept[6] > 30
    assert reset[7] < 0.7 * reset[6]
    assert reset[14] < 0.7 * reset[13]


def small_matrix(jobs: int) -> pd.DataFrame:
    challenges = [find("original"), find("forgetting_student")]
    cells = matrix.cells_of(["random", "odd_levels:NeedsLow"], challenges, list(KnowledgeLevel))
    runs = list(matrix.run_cells(cells, [0, 1], 200, jobs))
    assert len(runs) == matrix.run_count(cells, [0, 1]) == 8  # 4 of random, 4 of the other at level low
    return matrix.tabulate(cells, runs)


@pytest.mark.slow
def test_levels_share_runs_and_more_processes_change_nothing() -> None:
    frame = small_matrix(jobs=2)
    pd.testing.assert_frame_equal(frame, small_matrix(jobs=1))
    random = frame[frame["teacher"] == "random"]
    assert set(random["effective_knowledge"]) == {"none"}
    assert len(random) == 12
    refused = frame[frame["effective_knowledge"].isna()]
    assert set(refused["expert_knowledge"]) == {"none"}
    assert set(refused["teacher"]) == {"odd_levels:NeedsLow"}
    expected = simulate(find("forgetting_student"), "random", NONE, 1, 200).curve
    row = random[(random["challenge"] == "forgetting_student") & (random["seed"] == 1)].iloc[0]
    assert tuple(row.loc["at_05":"at_100"]) == expected
    assert (row["before_reset"], row["tenth_later"]) == (expected[6], expected[8])
    assert row["three_tenths_later"] == expected[12]


def example_frame() -> pd.DataFrame:
    """Random at 10 ± 1, a better teacher that needs a threshold, five seeds each."""
    rows = []
    for seed, noise in enumerate((-1.0, -0.5, 0.0, 0.5, 1.0)):
        base = {"challenge": "original", "seed": seed, "before_reset": np.nan}
        for level in ("none", "low", "high"):
            own = {"expert_knowledge": level, "effective_knowledge": "none"}
            rows.append({"teacher": "random", **base, **own, "mastered_percent": 10 + noise})
        for level in ("low", "high"):
            own = {"expert_knowledge": level, "effective_knowledge": level}
            rows.append({"teacher": "better", **base, **own, "mastered_percent": 30 - noise})
    rows.append({"teacher": "better", "challenge": "original", "expert_knowledge": "none"})
    return pd.DataFrame(rows)


def test_the_table_shows_intervals_sharing_and_refusals() -> None:
    """Five values of standard deviation sqrt(0.625): t(0.975, 4) = 2.776, so the margin is 0.98."""
    table = simulated.mastered_table(example_frame())
    rows = [tuple(row) for row in table.to_numpy()]
    assert rows == [
        ("random", "none = low = high", "10.0 ± 1.0"),
        ("better", "none", "–"),  # noqa: RUF001 - an en dash
        ("better", "low", f"30.0 ± 1.0 {simulated.BETTER}"),
        ("better", "high", f"30.0 ± 1.0 {simulated.BETTER}"),
    ]
    lines = simulated.markdown(table).splitlines()
    assert lines[0] == "| teacher | expert knowledge | original |"
    assert lines[2] == "| random | none = low = high | 10.0 ± 1.0 |"


def test_marks_are_those_after_holm() -> None:
    """Three pairs have p = 0.036 (t = 2.5 / (0.85 / sqrt 3)) alone, and 0.073 as a family of two."""
    levels = {"expert_knowledge": "none", "effective_knowledge": "none"}
    rows = [
        {"teacher": teacher, "challenge": "original", "seed": seed, "before_reset": np.nan}
        | {**levels, "mastered_percent": mean + seed * spread}
        for teacher, mean, spread in (("random", -1.0, 1.0), ("one", 2.35, 0.15), ("other", 2.35, 0.15))
        for seed in range(3)
    ]
    frame = pd.DataFrame(rows)
    alone = simulated.mastered_table(frame[frame["teacher"] != "other"])
    assert alone["original"].tolist() == ["0.0 ± 2.5", f"2.5 ± 0.4 {simulated.BETTER}"]
    assert simulated.mastered_table(frame)["original"].tolist() == ["0.0 ± 2.5", "2.5 ± 0.4", "2.5 ± 0.4"]


def test_a_matrix_that_is_refused_as_a_whole_is_a_row_of_dashes(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["simulate", "--teachers", "odd_levels:NeedsLow", "--expert-knowledge", "none"]
    assert main([*arguments, "--challenges", "original"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[-2:] == ["none", "–"]  # noqa: RUF001


@pytest.mark.slow
def test_the_command_writes_rows_and_shows_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["simulate", "--teachers", "random,odd_levels:NeedsLow", "--challenges", "forgetting_student"]
    command += ["--expert-knowledge", "none,low", "--seeds", "2", "--episodes", "100"]
    for file in ("rows.csv", "rows.parquet"):
        assert main([*command, "-o", str(tmp_path / file)]) == 0
    shown = capsys.readouterr().out
    assert "none = low" in shown
    assert "before" in shown
    frame = pd.read_csv(tmp_path / "rows.csv")
    assert list(frame["seed"].dropna()) == [0, 1, 0, 1, 0, 1]
    assert frame["effective_knowledge"].isna().sum() == 1
    stored = pd.read_parquet(tmp_path / "rows.parquet")
    pd.testing.assert_frame_equal(frame, stored, check_dtype=False)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (["--teachers", "randm"], "did you mean 'random'"),
        (["--challenges", "easy"], "no simulated challenge 'easy'"),
        (["--expert-knowledge", "some"], "unknown level of expert knowledge 'some'"),
        (["-o", "rows.xlsx"], r".csv or .parquet"),
        (["-o", "nowhere/rows.csv"], "does not exist"),
    ],
)
def test_mistakes_are_refused(wrong: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", *wrong]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="finds the workers through /proc")
def test_a_killed_command_leaves_no_process_behind() -> None:
    arguments = ["simulate", "--teachers", "random", "--challenges", "original", "--seeds", "500"]
    command = subprocess.Popen([sys.executable, "-m", "tma_ray", *arguments], stdout=subprocess.PIPE)
    children = Path(f"/proc/{command.pid}/task/{command.pid}/children")
    while len(children.read_text().split()) < 2:  # a worker, and the resource tracker of multiprocessing
        assert command.poll() is None
        time.sleep(0.1)
    command.kill()
    command.communicate(timeout=30)  # the pipe ends when nobody holds it any more
