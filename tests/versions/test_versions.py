"""No behaviour changes under a version that was released: see version_table.py."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import version_table
from behaviour_traces import PHYSICS_VERSION, TOLERANCE, catalogue, trace, traces, version

from tma_ray.students import STUDENTS

TABLE = version_table.load()


@pytest.mark.parametrize(("part", "name"), catalogue())
def test_behaviour_is_that_of_its_version(part: str, name: str) -> None:
    problem = version_table.behaviour_problem(TABLE, part, name, traces(part, name))
    assert problem is None, problem


def test_the_benchmark_is_that_of_its_version() -> None:
    problem = version_table.benchmark_problem(TABLE)
    assert problem is None, problem


def test_the_table_has_nothing_else() -> None:
    assert {(part, name) for part, names in TABLE["traces"].items() for name in names} == set(catalogue())


def test_all_that_ships_has_a_version() -> None:
    for part, name in catalogue():
        assert version(part, name).partition(",")[0].isdecimal(), (part, name)


@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_versions_known_without_torch_are_those_of_the_classes(name: str) -> None:
    assert STUDENTS.algorithm_version(name) == STUDENTS.get(name).algorithm_version


def test_a_trace_shows_one_value_that_changed_and_no_rounding() -> None:
    rows = np.random.default_rng(3).normal(size=(150, 3))
    rounded, changed = rows * (1 + 1e-6), rows.copy()
    changed[75, 1] += 0.01
    apart = [np.abs(np.subtract(trace(rows), trace(other))).max() for other in (rounded, changed)]
    assert apart[0] < TOLERANCE < apart[1]


def frozen(released: bool = True) -> version_table.Table:
    table = copy.deepcopy(TABLE)
    for entry in table["benchmarks"].values():
        entry["released"] = released
    return table


def test_a_released_behaviour_cannot_change_without_its_version(monkeypatch: pytest.MonkeyPatch) -> None:
    found = copy.deepcopy(TABLE["traces"]["teacher"]["adr"]["traces"])
    number = int(version("teacher", "adr"))
    assert version_table.behaviour_problem(frozen(), "teacher", "adr", found) is None
    found["low"][0] += 1
    with pytest.raises(
        ValueError, match=f"behaviour of teacher 'adr' changed.*algorithm_version to {number + 1}"
    ):
        version_table.renewed(frozen(), {("teacher", "adr"): found})
    unreleased = version_table.renewed(frozen(released=False), {("teacher", "adr"): found})
    assert unreleased["traces"]["teacher"]["adr"]["traces"] == found

    monkeypatch.setattr(version_table, "version", lambda part, name: "99")
    with pytest.raises(ValueError, match="raise BENCHMARK_VERSION"):
        version_table.renewed(frozen(), {("teacher", "adr"): found})
    monkeypatch.setattr(version_table, "BENCHMARK_VERSION", version_table.BENCHMARK_VERSION + 1)
    raised = version_table.renewed(frozen(), {("teacher", "adr"): found})
    assert raised["traces"]["teacher"]["adr"] == {"version": "99", "traces": found}
    assert not raised["benchmarks"][str(version_table.BENCHMARK_VERSION)]["released"]


def test_what_is_added_to_a_released_benchmark_needs_no_new_version(monkeypatch: pytest.MonkeyPatch) -> None:
    before = frozen()
    del before["benchmarks"][str(version_table.BENCHMARK_VERSION)]["algorithm_versions"]["teacher"]["adr"]
    assert version_table.benchmark_problem(before) is None
    assert version_table.released(before, "teacher", "adr") is None
    monkeypatch.setattr(version_table, "PHYSICS_VERSION", version_table.PHYSICS_VERSION + 1)
    assert "physics_version" in str(version_table.benchmark_problem(before))


def test_an_environments_behaviour_is_pinned_with_the_physics() -> None:
    assert version("environment", "parkour").endswith(f"physics {PHYSICS_VERSION}")
