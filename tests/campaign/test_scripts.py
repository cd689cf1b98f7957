"""Experiments as scripts: what their flags choose, what they say before they start, what they refuse."""

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from analysis.commands import rankings
from analysis.pages import report
from tma_ray import cli
from tma_ray.benchmark import (
    EXPERIMENTS,
    MATRICES,
    ORIGINAL_SPACE,
    PARKOUR,
    STUMP_TRACKS_CHALLENGES,
    Matrix,
    find_experiment,
)
from tma_ray.campaign import (
    Campaign,
    Plan,
    cells_of,
    costs,
    experiments,
    joined_plan,
    matrix_campaigns,
    matrix_cells,
    script,
)
from tma_ray.campaign.costs import Cost, Throughput, estimate
from tma_ray.campaign.experiments import experiment_plan
from tma_ray.campaign.options import ExperimentOptions
from tma_ray.campaign.plan import planned_experiments
from tma_ray.campaign.settings import ExecutionConfig, Resources
from tma_ray.cli import main
from tma_ray.console.command_line import read
from tma_ray.runs import Schedule

SCRIPTS = Path(__file__).parents[2] / "experiments"


def planned(name: str, *arguments: str) -> Plan:
    call = read(cli.app(), ["plan", name, *arguments])
    return experiment_plan(find_experiment(name), call.keywords.get("options", ExperimentOptions()))


def values(plan: Plan, column: str) -> set[object]:
    return {row[column] for row in plan.cell_rows}


def test_every_experiment_has_a_script() -> None:
    assert {each.name for each in EXPERIMENTS} | {"quickstart"} == {
        path.stem for path in SCRIPTS.glob("*.py")
    }
    for experiment in EXPERIMENTS:
        assert f'"experiment", "{experiment.name}"' in (SCRIPTS / f"{experiment.name}.py").read_text()


def test_flags_choose_from_an_experiment() -> None:
    plan = planned(
        "full_benchmark", "--tier", "lite", "--teachers", "random,adr", "--challenges",
        "mostly_trivial,diverse_students", "--expert-knowledge", "low", "--seeds", "2", "--steps", "1M",
    )  # fmt: skip
    assert values(plan, "challenge") == {"mostly_trivial", "diverse_students"}
    assert values(plan, "teacher") == {"random", "adr"}
    assert values(plan, "expert_knowledge") == {"low"}
    assert len(plan.runs) == 2 * (1 + 2) * 2
    found = {(s.student, s.schedule.steps, s.schedule.evaluation_interval) for s in plan.runs}
    assert found == {("ppo:preset=decisive", 1_000_000, 250_000)}


def test_a_stage_runs_every_first_seed_first_at_the_highest_level_that_makes_a_difference() -> None:
    plan = planned("lite_1", "--stage", "core")
    assert (plan.name, len(plan.runs), len(plan.cell_rows)) == ("lite_1_core", 350, 350)
    assert [spec.seed for spec in plan.runs] == sorted(spec.seed for spec in plan.runs)
    assert values(plan, "expert_knowledge") == {"high"}
    levels = {spec.teacher: spec.expert_knowledge.value for spec in plan.runs}
    assert (levels["random"], levels["alp_gmm"], levels["setter_solver"]) == ("none", "high", "low")
    assert {"goal_gan:preset=release", "spdl:preset=release"} < set(levels)
    assert len({spec.run_id for spec in plan.runs} & {s.run_id for s in planned("lite_1").runs}) == 350


def test_the_stage_of_todays_teachers_has_their_cells_alone() -> None:
    plan = planned("lite_1", "--stage", "today")
    assert (plan.name, len(plan.runs)) == ("lite_1_today", 8 * 3 * 3)
    assert values(plan, "challenge") == {"original", "mostly_unfeasible", "rugged_difficulty"}
    assert {spec.seed for spec in plan.runs} == {0, 1, 2}
    assert "ramp:steps=1000000" in values(plan, "teacher")
    today = planned("lite_1", "--stage", "today", "--teachers", "sfl,ramp")
    assert values(today, "teacher") == {"sfl", "ramp:steps=1000000"}


def test_lite_2_tests_the_decisive_student_twice_as_often_on_half_of_the_tasks() -> None:
    core, later = (planned("lite_2", "--stage", stage) for stage in ("core", "later"))
    assert (len(core.runs), len(later.runs)) == (350, 280)
    for spec in (*core.runs, *later.runs):
        assert spec.student == "ppo:preset=decisive"
        assert (spec.schedule.evaluation_interval, len(spec.test_set)) == (125_000, 50)
    assert {"plr:budget=2000000", "doraemon:budget=2000000", "currot"} < values(later, "teacher")
    assert {"plr", "doraemon"} < values(planned("lite_2", "--stage", "authors"), "teacher")
    parkour = planned("lite_2", "--stage", "parkour")
    assert {(spec.embodiment, spec.test_set.name) for spec in parkour.runs} == {
        ("classic_bipedal", "parkour_walking:every=2"),
        ("fish", "parkour_swimming:every=2"),
        ("climbing_chimpanzee", "parkour_climbing:every=2"),
    }


def test_students_of_the_users_own_take_the_place_of_the_papers() -> None:
    plan = planned("parkour", "--students", "TD3", "--embodiments", "fish", "--teachers", "random")
    assert {(spec.student, spec.embodiment) for spec in plan.runs} == {("TD3", "fish")}
    assert {spec.seed for spec in plan.runs} == set(range(16, 32))


def test_seeds_are_places_in_each_matrixs_own() -> None:
    plan = planned("parkour", "--seeds", "1-2", "--teachers", "random")
    assert {(spec.embodiment, spec.seed) for spec in plan.runs} == {
        ("classic_bipedal", 1), ("classic_bipedal", 2), ("fish", 17), ("fish", 18),
        ("climbing_chimpanzee", 33), ("climbing_chimpanzee", 34),
    }  # fmt: skip
    assert len(planned("parkour", "--seeds", "5", "--tier", "lite", "--teachers", "random").runs) == 10


def test_a_tier_has_budgets_and_lite_no_climbers(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plan = planned("full_benchmark", "--tier", "lite", "--teachers", "random")
    budgets = {(spec.environment, spec.schedule.steps) for spec in plan.runs}
    assert budgets == {("stump_tracks", 2_000_000), ("parkour", 6_000_000)}
    bodies = {spec.embodiment for spec in plan.runs if spec.environment == "parkour"}
    assert bodies == {"classic_bipedal", "fish"}
    assert plan.budgets == {"stump_tracks": 2_000_000, "parkour": 6_000_000}
    shorter = planned("full_benchmark", "--tier", "lite", "--teachers", "random", "--steps", "1M")
    assert {spec.schedule.steps for spec in shorter.runs} == {1_000_000}
    arguments = ["--tier", "lite", "--results", str(tmp_path), "--teachers", "random"]
    assert main(["plan", "parkour", *arguments]) == 0
    assert "Climbers are left out of this tier" in capsys.readouterr().out
    assert main(["plan", "parkour", *arguments, "--embodiments", "fish"]) == 0
    assert "Climbers" not in capsys.readouterr().out
    assert main(["plan", "parkour", *arguments, "--embodiments", "climbing_chimpanzee"]) == 2
    assert "'climbing_chimpanzee': Climbers are left out of this tier" in capsys.readouterr().err


def test_teachers_select_where_the_experiment_names_its_own() -> None:
    plan = planned("case_studies", "--teachers", "adr")
    assert values(plan, "experiment") == {
        "needs_of_adr_mostly_unfeasible", "needs_of_adr_mostly_trivial", "needs_of_adr_rugged_difficulty",
        "recovery_forgetting_student",
    }  # fmt: skip
    assert len(planned("hyperparameter_search", "--teachers", "spdl").runs) == 72 * 16


def test_sample_efficiency_runs_nothing_that_the_challenges_do_not() -> None:
    arguments = ("--tier", "lite", "--teachers", "riac,alp_gmm")
    challenges = {spec.run_id for spec in planned("stump_tracks_challenges", *arguments).runs}
    assert {spec.run_id for spec in planned("sample_efficiency", *arguments).runs} < challenges


def test_a_search_tries_each_point_apart_in_a_row_of_its_own() -> None:
    plan = planned("hyperparameter_search", "--tier", "lite", "--teachers", "alp_gmm", "--seeds", "1")
    assert len(plan.runs) == 12
    assert values(plan, "experiment") == {f"search_alp_gmm_{place:02}" for place in range(12)}
    assert len({str(spec.teacher_hyperparameters) for spec in plan.runs}) == 12
    ppo = planned("ppo_search", "--tier", "smoke")
    assert len({str(spec.student_hyperparameters) for spec in ppo.runs}) == 2


def test_every_cells_first_seed_comes_before_any_second() -> None:
    plan = planned("full_benchmark", "--tier", "lite", "--teachers", "random,alp_gmm")
    first = [spec.seed in (0, 16, 32) for spec in plan.runs]
    assert first == sorted(first, reverse=True)
    assert sum(first) == len(plan.runs) / 3


def test_joined_plans_share_runs() -> None:
    cells, schedule = cells_of(("random",), ("ppo",)), Schedule(steps=100)
    campaigns = [Campaign(name, cells, (0, 1), schedule) for name in ("first", "second")]
    plan = joined_plan("both", campaigns)
    assert (plan.name, len(plan.runs), len(plan.cell_rows)) == ("both", 2, 4)
    assert values(plan, "experiment") == {"first", "second"}


def test_a_stage_that_repeats_cells_of_another_counts_them_once() -> None:
    cells, schedule = cells_of(("random",), ("ppo",)), Schedule(steps=100)
    campaigns = [Campaign("one", cells, tuple(range(seeds)), schedule) for seeds in (2, 3)]
    plan = joined_plan("both", campaigns)
    assert plan.describe() == "campaign 'both': 1 cell, 3 with their seeds = 3 runs, 300 environment steps"
    assert [part["asked"] for part in planned_experiments(plan)] == [3]


def test_a_matrix_that_nobody_knows_enough_for_is_left_out() -> None:
    original = find_experiment("stump_tracks_challenges").matrices[0]
    assert matrix_campaigns([original], ("adr",))[0].cells[0].expert_knowledge == "low"
    with pytest.raises(ValueError, match=r"nothing of .stump_tracks_challenges. is left"):
        planned("stump_tracks_challenges", "--teachers", "adr", "--expert-knowledge", "none")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["full_benchmark", "--challenges", "ruged"], "no challenge 'ruged'"),
        (["full_benchmark", "--embodiments", "fsh"], "no embodiment 'fsh' in this experiment: did you mean"),
        (["full_benchmark", "--expert-knowledge", "medium"], "unknown level of expert knowledge 'medium'"),
        (["full_benchmark", "--teachers", "alp_gm"], "did you mean 'alp_gmm'"),
        (["case_studies", "--teachers", "alp_gm"], "did you mean 'alp_gmm'"),
        (["full_benchmark", "--students", "pppo"], "did you mean 'ppo'"),
        (["parkour", "--seeds", "14-16"], "parkour_walking has 16 seeds, at places 0 to 15"),
        (["parkour", "--expert-knowledge", "high"], "nothing of .parkour. is left"),
        (["compare_new_teacher"], "--teachers mine:Teacher"),
        (["compare_new_teacher", "--tier", "smoke"], "--teachers mine:Teacher"),
    ],
)  # fmt: skip
def test_what_cannot_run_is_refused(arguments: list[str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        planned(*arguments)


def test_a_dry_run_says_size_and_cost_and_starts_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(costs, "machine_speed", lambda _: costs.REFERENCE_ROUNDS)
    root = tmp_path / "root"
    arguments = ["--tier", "smoke", "--dry-run", "--challenges", "original", "--results", str(root)]
    assert main(["experiment", "stump_tracks_challenges", *arguments]) == 0
    shown = capsys.readouterr().out
    assert "2 cells, 2 with their seeds = 2 runs, 8,000 environment steps" in shown
    assert "ppo on stump_tracks classic_bipedal" in shown
    assert not root.exists()
    assert main(["experiment", "parkour", "--teachers", "alp_gm", "--results", str(root)]) == 2
    assert "did you mean 'alp_gmm'" in capsys.readouterr().err
    assert not root.exists()


def test_the_results_that_an_experiment_ends_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search shows its best points, others the ranking at the share of the budget that they are read at."""
    shown: list[object] = []
    monkeypatch.setattr(experiments, "execute_experiment", lambda experiment, options: 0)
    monkeypatch.setattr(rankings, "show_ranking", lambda *arguments: shown.append(arguments))
    monkeypatch.setattr(rankings, "show_search", shown.append)
    for experiment in EXPERIMENTS:
        assert main(["experiment", experiment.name, "--results", experiment.name]) == 0
        root = experiment.name
        assert shown.pop() == (root if experiment.searches else (root, experiment.read_at))
    assert main(["experiment", "parkour", "--dry-run"]) == 0
    assert not shown


def test_costs_follow_from_measured_throughput() -> None:
    """Two cells of two seeds: 4 runs that start for 8 s, train 1,000 s and evaluate twice for 10 s."""
    schedule = Schedule(steps=1_000_000, evaluation_interval=1_000_000)
    campaign = Campaign("costly", cells_of(("random", "riac")), (0, 1), schedule)
    throughput = Throughput("sac", training=1_000, playing=10_000, transition_bytes=120)
    settings = ExecutionConfig(Resources(cpus=2.0, gpus=0.25), device="cuda")
    cost = estimate(campaign.plan(), settings, find_speeds=lambda kinds, *_: dict.fromkeys(kinds, throughput))
    assert cost.hours == pytest.approx(4 * (8 + 1_000 + 20) / 3600)
    assert "2.3 core-hours and 0.29 GPU-hours" in cost.describe()
    assert cost.memory_gib == pytest.approx(cost.at_once * (0.9 + 120e6 / 2**30))
    assert isinstance(cost, Cost)


FROM_LOW_KNOWLEDGE = ("adr", "goal_gan", "setter_solver")

PAPERS = ("random", "riac", "alp_gmm", "covar_gmm", "spdl", *FROM_LOW_KNOWLEDGE)
"""Other tests may have registered more."""


def counts(matrices: Iterable[Matrix], teacher: str) -> tuple[int, int]:
    """Run as the paper counts them, and those that are executed."""
    plans = [campaign.plan() for campaign in matrix_campaigns(matrices, (teacher,))]
    run_ids = {spec.run_id for plan in plans for spec in plan.runs}
    return sum(len(plan.cell_rows) for plan in plans), len(run_ids)


@pytest.mark.parametrize("teacher", PAPERS)
def test_cells_are_the_papers(teacher: str) -> None:
    """Appendix C: 15 experiments of 32 seeds, diverse students in four parts; 10 without a level too low."""
    levels = 2 if teacher in FROM_LOW_KNOWLEDGE else 3
    sizes = [len(matrix_cells(matrix, (teacher,))) for matrix in STUMP_TRACKS_CHALLENGES]
    assert sizes == [levels, levels, levels, levels, 4 * levels]
    assert len(matrix_cells(ORIGINAL_SPACE, (teacher,))) == levels
    assert [len(matrix_cells(matrix, (teacher,))) for matrix in PARKOUR] == [1, 1, 1]


@pytest.mark.parametrize(
    ("teacher", "challenges", "original"),
    [
        ("random", (768, 256), (96, 32)),
        ("riac", (768, 256), (96, 32)),
        ("alp_gmm", (768, 512), (96, 64)),
        ("spdl", (768, 512), (96, 64)),
        ("adr", (512, 512), (64, 64)),
        ("setter_solver", (512, 256), (64, 32)),
    ],
)
def test_equal_levels_run_once(teacher: str, challenges: tuple[int, int], original: tuple[int, int]) -> None:
    assert counts(STUMP_TRACKS_CHALLENGES, teacher) == challenges
    assert counts([ORIGINAL_SPACE], teacher) == original
    assert counts(PARKOUR, teacher) == (48, 48)


def test_all_teachers_together() -> None:
    """Five that run everywhere and three that need low knowledge."""
    cells = {matrix.name: len(matrix_cells(matrix, PAPERS)) * len(matrix.seeds) for matrix in MATRICES}
    assert sum(cells[matrix.name] for matrix in STUMP_TRACKS_CHALLENGES) == 5 * 768 + 3 * 512
    assert sum(cells[matrix.name] for matrix in PARKOUR) == 8 * 48
    assert cells[ORIGINAL_SPACE.name] == 5 * 96 + 3 * 64


def test_parkours_bodies_share_no_seed() -> None:
    assert sorted(seed for matrix in PARKOUR for seed in matrix.seeds) == list(range(48))
    bodies = [matrix.embodiments for matrix in PARKOUR]
    assert bodies == [("classic_bipedal",), ("fish",), ("climbing_chimpanzee",)]


def test_a_matrix_becomes_a_campaign_with_its_seeds_and_any_budget() -> None:
    first, *_ = matrix_campaigns(PARKOUR, ("random",), Schedule(steps=1_000))
    assert (first.name, first.seeds, first.schedule.steps) == ("parkour_walking", tuple(range(16)), 1_000)
    assert matrix_campaigns([ORIGINAL_SPACE], ("random",))[0].schedule == Schedule()


ROOT = Path(__file__).parents[2]


@pytest.fixture
def code(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """What the campaign ends with; nothing is measured, trained or written."""
    codes = [0]
    measured = Throughput("any", 1e4, 1e4, 100)
    monkeypatch.setattr(costs, "measured_speeds", lambda kinds, *_: dict.fromkeys(kinds, measured))
    monkeypatch.setattr(script, "execute", lambda campaign, options: codes[0])
    monkeypatch.setattr(report, "write_report", lambda root, output: Path(root) / "report" / "index.html")
    return codes


def test_every_stage_is_announced_and_timed(code: list[int], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["quickstart", "--results", "out"]) == 0
    shown = capsys.readouterr().out
    assert re.findall(r"^\[(\d)/3\]", shown, re.MULTILINE) == ["1", "2", "3"]
    assert re.search(r"^\[2/3\] Training: .*core-hours, \d+ min with \d+ runs? at once", shown, re.MULTILINE)
    for stage in ("compilation", "training", "report"):
        assert re.search(rf"^  {stage}.* 0 min \d\d s$", shown, re.MULTILINE)
    assert shown.endswith("open out/report/index.html in a browser, then type\n  tma-ray ranking out\n")


def test_a_stage_that_fails_ends_it(code: list[int], capsys: pytest.CaptureFixture[str]) -> None:
    code[0] = 130
    assert main(["quickstart", "--results", "out"]) == 130
    assert "[3/3]" not in capsys.readouterr().out


def test_a_dry_run_says_what_would_be_trained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "root"
    assert main(["quickstart", "--dry-run", "--results", str(root)]) == 0
    assert "2 cells x 3 seeds = 6 runs, 4,200,000 environment steps" in capsys.readouterr().out
    assert not root.exists()


def test_make_calls_the_command() -> None:
    told = subprocess.run(["make", "-n", "quickstart"], cwd=ROOT, capture_output=True, text=True)
    assert ".venv/bin/tma-ray quickstart --results results" in told.stdout


def test_the_installation_names_its_stages() -> None:
    told = subprocess.run(
        ["make", "-n", "-W", "requirements.lock", "install"], cwd=ROOT, capture_output=True, text=True
    )
    assert told.returncode == 0
    announced = [line for line in told.stdout.splitlines() if line.startswith("echo ")]
    assert [line.split()[1].strip('"') for line in announced[:3]] == ["Creating", "Downloading", "Installing"]
