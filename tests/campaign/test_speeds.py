"""Speeds of runs: measured side by side, remembered per machine and version, within a time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import pytest

from tma_ray.campaign import Campaign, cells_of
from tma_ray.campaign.costs import known, measuring
from tma_ray.campaign.costs.cohort_speed import measure_cohort
from tma_ray.campaign.costs.estimation import estimate
from tma_ray.campaign.costs.known import kind_of, measured_speeds, quick_speeds
from tma_ray.campaign.costs.memory import remember, remembered, speed_key, speeds_file
from tma_ray.campaign.costs.speed import Source, Throughput
from tma_ray.campaign.plan import QUICKSTART
from tma_ray.campaign.settings import Settings
from tma_ray.runs import RunSpec, Schedule


@pytest.fixture(autouse=True)
def new_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def spec_of(student: str = "ppo", body: str = "classic_bipedal") -> RunSpec:
    cells = cells_of(("random",), (student,), embodiments=(body,))
    (spec,) = Campaign("fast", cells, (0,), Schedule(steps=100_000)).plan().runs
    return spec


def throughput(training: float) -> Throughput:
    return Throughput("any", training, 10 * training, 100)


def test_what_was_measured_is_remembered_for_the_same_machine_version_and_settings() -> None:
    spec, settings = spec_of(), Settings()
    remember({speed_key(spec, settings, 2): throughput(1_000)})
    found = quick_speeds({kind_of(spec): spec}, settings, 2)[kind_of(spec)]
    assert (found.training, found.source) == (1_000, Source.REMEMBERED)
    assert found.measured_on == date.today().isoformat()
    others = [
        (replace(spec, physics_version=0), 2),
        (replace(spec, algorithm_versions={"student": 0}), 2),
        (spec_of("ppo:epochs=50"), 2),
        (spec_of(body="spider"), 2),
        (spec, 3),
    ]
    assert all(speed_key(other, settings, at_once) not in remembered() for other, at_once in others)


def test_a_kind_that_is_not_measured_in_time_has_its_shipped_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known, "PATIENCE_SECONDS", 0.01)  # less than a process takes to start
    spec = spec_of()
    found = measured_speeds({kind_of(spec): spec}, Settings(), 1)[kind_of(spec)]
    assert found.source is Source.SHIPPED
    assert found.training == known.KNOWN["ppo"].training
    assert not speeds_file().exists()


@pytest.mark.slow  # starts a process for each core, which compile and import what they measure
def test_several_processes_measure_one_kind_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A student of its own hyper-parameters has no shipped speed: it is waited for."""
    spec = spec_of("ppo:hidden_units=8x8:steps_per_update=50:batch_size=50")
    cost = estimate(
        _plan(spec), Settings(), find_speeds=lambda kinds, settings, _: measured_speeds(kinds, settings, 2)
    )
    (found,) = cost.throughputs.values()
    assert found.source is Source.MEASURED
    assert 100 < found.training < found.playing
    monkeypatch.setattr(measuring, "measure_all", lambda *_: pytest.fail("measured again"))
    monkeypatch.setattr(known, "measure_all", lambda specs, *_: {} if not specs else pytest.fail("again"))
    (again,) = measured_speeds({kind_of(spec): spec}, Settings(), 2).values()
    assert (again.training, again.source) == (found.training, Source.REMEMBERED)


@pytest.mark.slow  # compiles everything
def test_the_bar_of_a_first_measurement_moves_with_each_kernel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[tuple[int, int]] = []

    @contextmanager
    def progress(_: object) -> Iterator[measuring.Show]:
        yield lambda done, total: shown.append((done, total))

    monkeypatch.setattr(measuring, "_progress", progress)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cold"))
    measuring.measure_all({"key": QUICKSTART.plan().runs[0]}, Settings(), 1, {})
    shares = [done / total for done, total in shown]
    assert shares == sorted(shares), "the total is known from the first kernel on"
    assert len(set(shares)) > 20
    assert shares[-1] == 1.0, "quickstart needs all kernels that count"


@pytest.mark.parametrize(
    ("learner", "cores", "hours", "bound"),
    [
        (1_000.0, 5, 1.0, "bound by the learner; the players' cores would take 16% of that time"),
        (16_000.0, 2, 0.625, "bound by the players' cores; the learner would take 10% of that time"),
    ],
)
def test_a_cohort_is_bound_by_its_learner_or_by_its_players_cores(
    monkeypatch: pytest.MonkeyPatch, learner: float, cores: int, hours: float, bound: str
) -> None:
    """Four runs of 900,000 steps: 900 s each of a learner at 1,000 steps/s, 562.5 s each of a player's core.

    The core's seconds: 8 for the start, 450 of training, 104.5 for two evaluations of 100 tasks.
    """
    monkeypatch.setattr("os.cpu_count", lambda: cores)
    schedule = Schedule(steps=900_000, evaluation_interval=900_000)
    plan = Campaign("shared", cells_of(("random",), ("ppo",)), (0, 1, 2, 3), schedule).plan()
    each = Throughput("ppo", 2_000, 200_000 / 104.5, 100, learner=learner)
    cost = estimate(plan, Settings(device="cuda"), find_speeds=lambda kinds, *_: dict.fromkeys(kinds, each))
    assert cost.wall_hours == pytest.approx(hours)
    assert cost.gpu_hours == pytest.approx(cost.wall_hours)
    assert bound in cost.summary()
    assert "GPU-hours" in cost.summary()


@pytest.mark.slow
def test_both_halves_of_a_cohort_are_measured() -> None:
    found = measure_cohort(
        spec_of("ppo:hidden_units=8x8:steps_per_update=50:batch_size=50"), Settings(cohort=3)
    )
    assert found.source is Source.MEASURED
    assert found.learner > 100
    assert found.training > 100
    other = spec_of("ppo:matmul_precision=high")
    with pytest.raises(ValueError, match="of ppo with precision high no GPU's speed is known"):
        measure_cohort(other, Settings(device="cuda"))


def test_a_kind_of_run_that_fails_says_why() -> None:
    broken = replace(spec_of("ppo:hidden_units=8x8"), student_hyperparameters={"hidden_unit": (8, 8)})
    with pytest.raises(ValueError, match=r"cannot measure the speed of ppo.*hidden_unit"):
        measured_speeds({kind_of(broken): broken}, Settings(), 1)


@pytest.mark.parametrize("content", ["", "[]", '{"a": 1}', '{"a": {"label": "x"}}'])
def test_a_damaged_memory_is_one_that_remembers_nothing(content: str) -> None:
    speeds_file().parent.mkdir(parents=True)
    speeds_file().write_text(content)
    assert remembered() == {}
    remember({"key": throughput(5)})
    assert list(remembered()) == ["key"]


def test_old_measurements_and_an_unwritable_memory_are_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    remember({"key": throughput(5)})
    entries = json.loads(speeds_file().read_text())
    entries["key"]["measured_on"] = (date.today() - timedelta(days=31)).isoformat()
    speeds_file().write_text(json.dumps(entries))
    assert remembered() == {}
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    remember({"key": throughput(5)})
    assert remembered() == {}


def test_a_cost_names_the_origin_of_each_speed() -> None:
    sources = {"ppo": Source.SHIPPED, "sac": Source.REMEMBERED}
    cells = cells_of(("random",), tuple(sources))
    plan = Campaign("both", cells, (0,), Schedule(steps=100_000)).plan()

    def found(kinds, settings, at_once):
        return {kind: replace(throughput(100), source=sources[kind[3]]) for kind in kinds}

    described = estimate(plan, Settings(), find_speeds=found).describe()
    assert "not measured here yet" in described
    assert "measured here before" in described


def _plan(spec: RunSpec):
    return replace(Campaign("one", cells_of(("random",), ("ppo",)), (0,)).plan(), runs=(spec,))
