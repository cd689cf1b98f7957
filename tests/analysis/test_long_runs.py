"""The rules of the predictions about the long runs, on results that are given."""

from collections.abc import Callable, Mapping

import pandas as pd
import pytest
from synthetic_pools import cell

from analysis.measures.pooling import pool_runs
from analysis.measures.tested import FINAL, HEADLINE
from analysis.statistics.samples import Standing

long_runs = pytest.importorskip("long_runs")

TEACHERS = (
    *("random", "adr", "alp_gmm", "covar_gmm", "riac", "goal_gan:preset=release", "spdl:preset=release"),
    *("setter_solver", "perm", "accel"),
)

Level = Callable[[str, int, int], float]
"""Function of a space, a teacher's number and a budget that returns mastered tasks in per cent."""


def plain(space: str, teacher: int, budget: int) -> float:
    """Return results in the order of teachers, the same at each budget."""
    return 0.0 if space == long_runs.CLIMBER else 20.0 + 5 * teacher


def results(last: Level = plain, first: Level = plain) -> Mapping[int, pd.DataFrame]:
    """Return all runs at all budgets: last three and area of a teacher, with 1 point between seeds."""
    rows = []
    for space, (environment, challenge, body) in long_runs.SPACES.items():
        climbs = space == long_runs.CLIMBER
        for number, teacher in enumerate(TEACHERS):
            for seed in range(2 if climbs else 3):
                if climbs <= (teacher in ("random", "alp_gmm")):
                    place = {"environment": environment, "challenge": challenge, "embodiment": body}
                    rows.append(
                        cell(teacher, seed, 0.0, **place, student="ppo") | {"number": number, "space": space}
                    )
    cells, runs = pd.DataFrame(rows), {}
    for budget in long_runs.BUDGETS:
        values = cells[["run_id"]].assign(step=float(budget))
        for measure, level in ((FINAL, last), (HEADLINE, first)):
            values[measure] = [
                level(row.space, row.number, budget) + (row.space != long_runs.CLIMBER) * row.seed
                for row in cells.itertuples()
            ]
        runs[budget] = pool_runs(cells.drop(columns=["mastered_percent", "step"]), values)
    return runs


ALL = pd.DataFrame({"done": 30, "needed": 30}, index=list(long_runs.SPACES))


def standings(last: Level = plain, first: Level = plain) -> list[str]:
    return long_runs.predictions(results(last, first), ALL)["standing"].tolist()


def test_nothing_is_judged_before_all_of_its_runs_are_done() -> None:
    needed = long_runs.planned()
    assert len(needed) == 124
    fish = long_runs.of_space(needed, long_runs.FISH)["run_id"]
    counts = long_runs.done(needed, [*fish[:-1], "another"])
    assert counts["done"].tolist() == [0, 29, 0, 0, 0]
    table = long_runs.predictions(results(), counts)
    assert set(table["standing"]) == {Standing.NO_DATA}
    assert table["evidence"].tolist()[5] == "29 of 60 runs are done"
    assert long_runs.agreement(results(), counts).empty


def test_orders_so_far_are_those_of_sets_that_lack_runs_but_no_teacher() -> None:
    runs, half = results(first=lambda space, teacher, budget: -5.0 * teacher), ALL.assign(done=15)
    table = long_runs.orders(runs, half)
    assert table["spaces"].tolist() == [name for name in long_runs.SETS for _ in range(3)]
    assert set(table["last three, tau"]) == {"\N{MINUS SIGN}1.00"}
    assert set(table["last three, pairs that change places"]) == {"45 of 45"}
    assert set(table["area, tau"]) == {"1.00"}
    assert set(table["fewest seeds"]) == {3}
    assert long_runs.orders(runs, ALL).empty
    fewer = {
        budget: rows[(rows["embodiment"] != "fish") | (rows["teacher"] != "perm")]
        for budget, rows in runs.items()
    }
    assert set(long_runs.orders(fewer, half)["spaces"]) == {"Stump Tracks, both challenges"}


@pytest.mark.parametrize(
    ("sign", "expected"), [(1, Standing.REFUTED), (-1, Standing.SUPPORTED)], ids=["kept", "turned"]
)
def test_an_order_that_is_kept_refutes_and_one_that_turns_supports(sign: int, expected: Standing) -> None:
    def first(space: str, teacher: int, budget: int) -> float:
        return 50.0 + sign * plain(space, teacher, budget)

    assert standings(first=first)[:3] == [expected] * 3
    table = long_runs.agreement(results(first=first), ALL)
    assert len(table) == 9
    turned = "0 of 45" if sign > 0 else "45 of 45"
    assert set(table["last three, pairs that change places"]) == {turned}
    assert set(table["area, pairs that change places"]) == {"0 of 45"}


@pytest.mark.parametrize("early", [0.0, 90.0])
def test_random_must_rank_high_at_both_budgets_on_one_space_and_low_on_the_other(early: float) -> None:
    def last(space: str, teacher: int, budget: int) -> float:
        value = plain(space, teacher, budget)
        if teacher or space != long_runs.ORIGINAL:
            return value
        return early if budget == 10_000_000 else 90.0

    assert standings(last)[3:5] == [Standing.SUPPORTED if early else Standing.REFUTED, Standing.SUPPORTED]


@pytest.mark.parametrize(
    ("more", "expected"), [(30.0, Standing.SUPPORTED), (2.5, Standing.UNDECIDED), (0.0, Standing.REFUTED)]
)
def test_all_three_must_be_better_than_random_with_the_body(more: float, expected: Standing) -> None:
    def last(space: str, teacher: int, budget: int) -> float:
        riac = TEACHERS[teacher] == "riac" and space == long_runs.FISH
        return plain(space, 0, budget) + (more if riac else 30.0 * (teacher > 0))

    assert standings(last)[5:7] == [expected, Standing.SUPPORTED]


def test_a_climber_that_climbs_refutes() -> None:
    def last(space: str, teacher: int, budget: int) -> float:
        return 1.0 if space == long_runs.CLIMBER else plain(space, teacher, budget)

    assert (standings()[-1], standings(last)[-1]) == (Standing.SUPPORTED, Standing.REFUTED)


def test_decided_pairs_are_those_of_the_ranks() -> None:
    table = long_runs.decided(results(), ALL)
    assert table["pairs"].tolist() == ["45 of 45"] * 4
    assert table["pairs with Random"].tolist() == ["9 of 9"] * 4
