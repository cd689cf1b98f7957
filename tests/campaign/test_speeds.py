"""Speeds of runs: of a table that is scaled to this machine, or measured; costs that follow from them."""

from dataclasses import replace

import pytest

from tma_ray.campaign import Campaign, cells_of, costs
from tma_ray.campaign.costs import REFERENCE_ROUNDS, Throughput, estimate, known_speeds, speed_key
from tma_ray.campaign.settings import ExecutionConfig
from tma_ray.embodiments import embodiment_names
from tma_ray.runs import RunSpec, Schedule
from tma_ray.students import STUDENTS
from tma_ray.students.catalogue import canonical_student
from tma_ray.support.component_names import base_name


def spec_of(student: str = "ppo", body: str = "classic_bipedal") -> RunSpec:
    cells = cells_of(("random",), (student,), embodiments=(body,))
    (spec,) = Campaign("fast", cells, (0,), Schedule(steps=100_000)).plan().runs
    return spec


def speed_of(spec: RunSpec, settings: ExecutionConfig | None = None) -> Throughput:
    return known_speeds({speed_key(spec): spec}, settings or ExecutionConfig(), 1)[speed_key(spec)]


@pytest.fixture
def half_as_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine of half the table's speed, on which nothing may be measured."""
    monkeypatch.setattr(costs, "machine_speed", lambda _: REFERENCE_ROUNDS / 2)
    monkeypatch.setattr(costs, "measure", lambda *_: pytest.fail("measured"))


def test_the_table_names_students_and_bodies_that_ship() -> None:
    table = costs._table()
    assert {("ppo", costs.DEFAULT_BODY), ("sac", costs.DEFAULT_BODY)} <= set(table)
    assert {body for _, body in table} <= set(embodiment_names())
    assert {base_name(student) for student, _ in table} <= set(STUDENTS.names())
    assert {canonical_student(student) for student, _ in table} == {student for student, _ in table}
    assert all(min(each.playing, each.training) > 0 for each in table.values())


@pytest.mark.usefixtures("half_as_fast")
def test_speeds_of_the_table_are_scaled_to_this_machine() -> None:
    listed = costs._table()["ppo", "spider"]
    found = speed_of(spec_of("ppo", "spider"))
    assert (found.training, found.playing) == (listed.training / 2, listed.playing / 2)
    assert found.label == "ppo on stump_tracks spider"
    wheel = speed_of(spec_of("sac", "wheel")).training
    assert wheel == costs._table()["sac", costs.DEFAULT_BODY].training / 2, "of another body"


@pytest.mark.usefixtures("half_as_fast")
def test_a_cohort_has_the_speeds_of_both_of_its_halves() -> None:
    on_cpu = speed_of(spec_of("ppo"), ExecutionConfig(cohort=4))
    on_gpu = speed_of(spec_of("sac:matmul_precision=high"), ExecutionConfig(device="cuda"))
    assert on_cpu.learner == costs.LEARNER_SPEEDS["ppo", "cpu", "highest"] / 2
    assert on_gpu.learner == costs.LEARNER_SPEEDS["sac", "cuda", "high"], "of another device"
    assert on_gpu.training == on_cpu.training == costs.PLAYER_SPEEDS[0] / 2


def test_the_measurement_of_this_machine_is_repeatable() -> None:
    assert costs.machine_speed(2) is costs.machine_speed(2), "measured once for a process"
    assert 0.2 < costs.machine_speed(1) / costs.machine_speed(2) < 5


def test_a_measurement_counts_whole_updates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(costs, "MEASURED_SECONDS", 0.01)
    spec = spec_of("ppo:hidden_units=8x8:steps_per_update=50:batch_size=50")
    few = replace(spec.test_set, tasks=spec.test_set.tasks[:3])
    found = costs.measure(replace(spec, test_set=few), ExecutionConfig())
    assert 100 < found.training < found.playing


@pytest.mark.slow
def test_runs_that_the_table_lacks_are_measured() -> None:
    found = speed_of(spec_of("ppo:hidden_units=8x8:steps_per_update=50:batch_size=50"))
    assert 100 < found.training < found.playing


@pytest.mark.slow
def test_a_kind_of_run_that_fails_says_why() -> None:
    broken = replace(spec_of("ppo:hidden_units=8x8"), student_hyperparameters={"hidden_unit": (8, 8)})
    with pytest.raises(ValueError, match=r"cannot measure the speed of ppo.*hidden_unit"):
        speed_of(broken)


@pytest.mark.parametrize(
    ("learner", "cores", "hours", "bound"),
    [
        (1_000.0, 5, 1.0, "bound by the learner; the rollout workers' cores would take 16% of that time"),
        (16_000.0, 2, 0.625, "bound by the rollout workers' cores; the learner would take 10% of that time"),
    ],
)
def test_a_cohort_is_bound_by_its_learner_or_by_its_workers_cores(monkeypatch, learner, cores, hours, bound):
    """Four runs of 900,000 steps: 900 s each of a learner (1,000 steps/s), 562.5 s each of a worker's core.

    The core's seconds: 8 for the start, 450 of training, 104.5 for two evaluations of 100 tasks.
    """
    monkeypatch.setattr("tma_ray.campaign.settings.usable_cores", lambda: cores)
    schedule = Schedule(steps=900_000, evaluation_interval=900_000)
    plan = Campaign("shared", cells_of(("random",), ("ppo",)), (0, 1, 2, 3), schedule).plan()
    each = Throughput("ppo", 2_000, 200_000 / 104.5, 100, learner=learner)
    on_gpu = ExecutionConfig(device="cuda")
    cost = estimate(plan, on_gpu, find_speeds=lambda kinds, *_: dict.fromkeys(kinds, each))
    assert cost.wall_hours == pytest.approx(hours)
    assert cost.gpu_hours == pytest.approx(cost.wall_hours)
    assert bound in cost.summary()
    assert "GPU-hours" in cost.summary()
    assert "an estimate" in cost.summary()
