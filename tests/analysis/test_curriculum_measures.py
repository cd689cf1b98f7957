import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_results import SyntheticCampaign

from analysis.data.frames import load
from analysis.measures.curriculum_measures import coverage_and_entropy, curriculum_curves, curriculum_measures
from tma_ray.tasks import TaskSpace

SQUARE = TaskSpace.from_bounds({"height": (0, 3), "spacing": (0, 6)})


def tasks(*rows: tuple[float, ...]) -> np.ndarray:
    return np.array(rows, dtype=np.float32)


def test_cells_and_entropy_by_hand() -> None:
    # Two bins a side: three tasks in one cell and one in the opposite one.
    found = coverage_and_entropy(tasks((0, 0), (1, 1), (1.4, 2.9), (3, 6)), SQUARE, bins=2)
    entropy = -(0.75 * math.log(0.75) + 0.25 * math.log(0.25)) / math.log(4)
    assert found == pytest.approx((0.5, entropy))


def test_one_task_in_each_cell_covers_all_evenly() -> None:
    centres = [(h, s) for h in 3 * (np.arange(10) + 0.5) / 10 for s in 6 * (np.arange(10) + 0.5) / 10]
    assert coverage_and_entropy(tasks(*centres), SQUARE) == pytest.approx((1, 1))


def test_one_task_over_and_over_covers_one_cell() -> None:
    assert coverage_and_entropy(tasks((1, 1), (1, 1)), SQUARE) == (0.01, 0.0)


def test_what_lies_outside_counts_at_the_edge() -> None:
    assert coverage_and_entropy(tasks((3, 6), (9, 9), (-1, -1)), SQUARE, bins=2)[0] == 0.5


def test_dimensions_without_width_do_not_count() -> None:
    wide = TaskSpace.from_bounds({"height": (0, 3), "width": (2, 2), "spacing": (0, 6)})
    two = tasks((0, 0), (1, 5), (2, 3))
    three = tasks(*[(h, 2, s) for h, s in two])
    assert coverage_and_entropy(three, wide) == coverage_and_entropy(two, SQUARE)


def test_many_dimensions_are_measured_one_by_one() -> None:
    space = TaskSpace.from_bounds(dict.fromkeys("abcd", (0, 1)))
    # Two bins: three dimensions where half of the tasks lie in each, one where all lie in one.
    found = coverage_and_entropy(tasks((0, 0, 0, 0), (1, 1, 1, 0)), space, bins=2)
    assert found == pytest.approx(((1 + 1 + 1 + 0.5) / 4, 3 / 4))


def test_without_tasks_or_a_choice_there_is_nothing_to_measure() -> None:
    point = TaskSpace.from_bounds({"height": (1, 1)})
    assert all(map(math.isnan, coverage_and_entropy(tasks((1.0,)), point)))
    assert all(map(math.isnan, coverage_and_entropy(np.empty((0, 2), np.float32), SQUARE)))


def test_a_grid_of_one_cell_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1 bins: expected .* at least 2"):
        coverage_and_entropy(tasks((1, 1)), SQUARE, bins=1)


@settings(deadline=None)  # machines may be busy
@given(st.lists(st.tuples(st.floats(0, 3), st.floats(0, 6)), min_size=1, max_size=40), st.integers(2, 12))
def test_both_lie_between_0_and_1(points: list[tuple[float, float]], bins: int) -> None:
    coverage, entropy = coverage_and_entropy(tasks(*points), SQUARE, bins)
    assert 0 < coverage <= 1
    assert -1e-12 <= entropy <= 1 + 1e-12
    assert round(coverage * bins**2) <= len(points)


def test_random_covers_more_than_a_guided_teacher(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, steps=40_000, evaluation_every=20_000, grid=2)
    runs = [campaign.run("alp_gmm", 0), campaign.run("random", 0)]
    frames = load(tmp_path)
    whole = curriculum_measures(frames, runs).set_index("run_id")
    assert list(whole.index) == runs
    for name in ("coverage", "entropy"):
        assert whole.loc[runs[1], name] > whole.loc[runs[0], name]
    curves = curriculum_curves(frames, runs)
    assert set(curves["tasks"]) == {40}
    assert curves.groupby("run_id")["tasks"].sum().to_dict() == whole["tasks"].to_dict()
    last = curves["step"].max()
    early = curriculum_measures(frames, runs, at=last - 1).set_index("run_id")
    assert (whole["tasks"] - early["tasks"] == 40).all()


def test_runs_without_probes_or_a_task_space_have_no_measures(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path, steps=40_000, evaluation_every=20_000, grid=2)
    runs = [
        campaign.plain_run("random", 0, {0: [1.0]}),
        campaign.run("random", 1, spec=json.dumps({})),
        campaign.run("random", 2, "waiting"),
    ]
    measured = curriculum_measures(load(tmp_path), runs)
    assert measured[["coverage", "entropy"]].isna().all(axis=None)
    assert list(measured["tasks"] > 0) == [False, True, False]
    assert curriculum_measures(load(tmp_path), []).empty
