"""Trials against lite-1: the design, verdicts of released teachers under other seeds, and their words."""

from dataclasses import replace
from typing import NamedTuple

import pandas as pd
import pytest
from scipy import stats

from analysis.baselines import find_baseline
from analysis.data.columns import CELL_COLUMNS
from analysis.data.frames import Frames
from analysis.measures.run_measures import evaluations_at
from analysis.measures.tested import FINAL, HEADLINE
from analysis.statistics import describe, least_variance, stratified
from analysis.trials.design import (
    Design,
    detectable,
    ended_runs,
    in_cell,
    make_design,
    moments_of,
    released_runs,
)
from analysis.trials.interim import (
    InterimLook,
    TrialEnding,
    completed_looks,
    curves,
    joined_trials,
    latex_row,
    look_line,
    methods,
    plan_lines,
    sentence,
    verdict_table,
)
from analysis.trials.rules import LOOKS, TrialVerdict


class Trial(NamedTuple):
    """A trial of a new teacher against lite-1, without its runs."""

    frames: Frames
    released: pd.DataFrame
    design: Design

    def runs(self, teacher: str, seeds: int = 20, points: float = 0.0) -> pd.DataFrame:
        """Return runs of the new teacher: those of a released one over and over, some points better."""
        rows = ended_runs(self.frames)
        found = []
        for cell in self.design.cells:
            own = rows[(rows[CELL_COLUMNS] == list(cell.key)).all(axis=1) & (rows["teacher"] == teacher)]
            own = pd.concat([own] * 10, ignore_index=True).head(seeds)
            changes = {"teacher": self.design.teacher, "seed": list(self.design.seeds[:seeds])}
            shifted = {"angle": own["angle"] + points / cell.slope, "end": own["end"] + points}
            found.append(own.assign(**shifted, **changes))
        return pd.concat(found, ignore_index=True)

    def looks(self, runs: pd.DataFrame, affordable: int | None = None) -> list[InterimLook]:
        return completed_looks(self.design, self.released, runs, affordable)


def designed(frames: Frames, *cells: str) -> Design:
    return make_design("mine:Frontier", find_baseline("lite-1"), frames, cells=cells)


@pytest.fixture(scope="module")
def trial() -> Trial:
    frames = find_baseline("lite-1").frames()
    return Trial(frames, released_runs(frames), designed(frames, "original", "diverse_students/spider"))


def test_the_design_says_whom_where_and_with_which_seeds(trial: Trial) -> None:
    design = trial.design
    assert design.release == "lite-1"
    assert design.references[0] == "random"
    means = ended_runs(trial.frames).groupby(["teacher", *CELL_COLUMNS])[HEADLINE].mean()
    candidates = ("alp_gmm", "goal_gan:preset=release", "riac")
    assert design.best == max(candidates, key=lambda name: sum(means[(name, *c.key)] for c in design.cells))
    assert [cell.name for cell in design.cells] == ["original", "diverse_students/spider"]
    assert min(design.seeds) > trial.frames.cells["seed"].max()
    assert design.looks == LOOKS
    assert design.simulated_error < 0.05


def test_a_design_survives_its_file_and_tells_another_one_apart(trial: Trial) -> None:
    again = Design.of(trial.design.to_dict(), "trial.json")
    assert again == trial.design
    assert again.differing(replace(again, margin=4.0)) == ["margin: 2.5, not 4.0"]
    assert "source" in again.differing(replace(again, runs="another"))[0]


def test_a_design_is_the_same_as_long_as_what_it_is_compared_with_is(trial: Trial) -> None:
    assert trial.design.renewed(trial.released) == trial.design
    others = trial.runs("riac", 5).assign(teacher="newcomer", run_id=[*map(str, range(10))])
    assert trial.design.renewed(pd.concat([trial.released, others])) == trial.design
    more = others.assign(teacher="random")
    found = trial.design.renewed(pd.concat([trial.released, more]))
    assert "release_digest" in trial.design.differing(found)[0]


def test_a_teacher_of_the_release_is_not_compared_with_itself(trial: Trial) -> None:
    cells = ["original", "diverse_students/spider"]
    again = make_design(trial.design.best, find_baseline("lite-1"), trial.frames, cells=cells)
    assert again.best != trial.design.best
    assert again.candidates == trial.design.candidates - 1


def test_a_trial_of_fewer_steps_compares_with_the_release_at_these_steps(trial: Trial) -> None:
    cells, steps = ("original", "diverse_students/spider"), 1_000_000
    design = make_design("mine:Frontier", find_baseline("lite-1"), trial.frames, cells=cells, steps=steps)
    released = released_runs(trial.frames, steps).set_index("run_id")
    expected = evaluations_at(trial.frames, [steps]).set_index("run_id").loc[released.index]
    for measure in design.axes:
        assert released[measure].tolist() == expected[measure].tolist()
    assert released[HEADLINE].mean() < 0.7 * trial.released[HEADLINE].mean()
    assert design.release_digest != trial.design.release_digest
    assert trial.design.differing(design)[-1] == "steps: None, not 1000000"
    hours = {cell.name: cell.hours for cell in trial.design.cells}
    assert all(cell.hours == pytest.approx(hours[cell.name] / 2) for cell in design.cells)
    short = trial._replace(design=design, released=released.reset_index())
    look = short.looks(short.runs("riac", 3))[0]
    assert "Over 2 cells of lite-1 after 1 million steps (" in sentence(design, look)
    assert Design.of(design.to_dict(), "trial.json") == design


@pytest.mark.parametrize("steps", [1_000_001, 2_250_000])
def test_steps_without_evaluations_are_refused_with_those_there_are(trial: Trial, steps: int) -> None:
    with pytest.raises(
        ValueError, match=r"no evaluations of original after .* every 250,000 up to 2,000,000"
    ):
        make_design("mine:Frontier", find_baseline("lite-1"), trial.frames, cells=["original"], steps=steps)


def test_curves_of_a_trial_of_fewer_steps_end_there(trial: Trial) -> None:
    design = replace(trial.design, steps=1_000_000)
    assert curves(design, trial.frames, trial.frames)["step"].max() == 1_000_000
    assert curves(trial.design, trial.frames, trial.frames)["step"].max() == 2_000_000


def test_an_unknown_cell_is_refused_with_those_there_are(trial: Trial) -> None:
    with pytest.raises(ValueError, match=r"no cell 'orginal'.*original"):
        designed(trial.frames, "orginal")


def test_a_much_better_teacher_wins_at_an_early_look(trial: Trial) -> None:
    looks = trial.looks(trial.runs(trial.design.best, 10, points=12.0))
    assert looks[-1].ending is TrialEnding.DECIDED
    assert [each.verdict for each in looks[-1].settled[:2]] == [TrialVerdict.BETTER, TrialVerdict.BETTER]
    assert looks[-1].seeds < LOOKS[-1]
    said = sentence(trial.design, looks[-1])
    assert "beside Random: better (sooner" in said
    assert "beside GoalGAN (release), the best of 9 there: sooner, and open in the end (sooner" in said


def test_random_again_is_never_better_and_worse_than_the_best(trial: Trial) -> None:
    settled = trial.looks(trial.runs("random"))[-1].settled[:2]
    assert settled[0].verdict is not TrialVerdict.BETTER
    assert settled[1].verdict is TrialVerdict.WORSE


def test_a_look_waits_for_all_of_its_runs_and_none_follows_the_end(trial: Trial) -> None:
    runs = trial.runs(trial.design.best)
    assert trial.looks(runs.iloc[:-1].head(2)) == []
    four = runs[runs["seed"].isin(trial.design.seeds[:4])]
    assert [look.seeds for look in trial.looks(four)] == [3]
    better = trial.looks(trial.runs(trial.design.best, points=30.0))
    assert sum(bool(look.ending) for look in better) == 1
    assert better[-1].ending


def test_an_open_comparison_tells_what_the_budget_could_still_show(trial: Trial) -> None:
    runs = trial.runs(trial.design.best, 3, points=2.0)
    chances = []
    for affordable in (0, 1, 3, None):
        finding = trial.looks(runs, affordable)[0].comparisons[0]
        assert finding.verdict is TrialVerdict.OPEN
        chances.append(finding.within_budget)
    assert chances[0] == 0
    assert chances[0] < chances[1] < chances[2] == chances[3] == finding.power
    said = look_line(trial.looks(runs, 1)[0])
    assert f"with probability {finding.power:.2f}, within the budget {chances[1]:.2f}" in said


def test_a_verdict_that_is_reached_stays(trial: Trial) -> None:
    runs = trial.runs("random", points=-5.0)
    later = runs["seed"].isin(trial.design.seeds[5:])
    runs.loc[later, "angle"] += 0.3  # from then on far better
    looks = trial.looks(runs)
    first = next(look for look in looks if look.comparisons[1].verdict is TrialVerdict.WORSE)
    assert first.seeds < looks[-1].seeds
    assert looks[-1].settled[1] == first.comparisons[1]


def test_runs_that_are_not_finite_are_left_out_by_number(trial: Trial) -> None:
    runs = trial.runs(trial.design.best, 5)
    runs.loc[0, "angle"] = float("nan")
    assert trial.looks(runs)[0].excluded == 1


def test_the_detectable_difference_falls_with_the_number_of_cells(trial: Trial) -> None:
    both = (trial.design, designed(trial.frames, "original"))
    runs = [moments_of(trial.released, "random", made.keys).runs for made in both]
    assert detectable(both[0], "random", runs[0]) < detectable(both[1], "random", runs[1])


def test_everything_that_is_written_has_the_numbers(trial: Trial) -> None:
    design, looks = trial.design, trial.looks(trial.runs(trial.design.best))
    assert any("6, 10, 20, 40 runs" in line for line in plan_lines(design, trial.released))
    table = verdict_table(design, looks)
    assert table["axis"].value_counts().to_dict() == dict.fromkeys(("sooner", "in the end"), 2 * len(looks))
    assert latex_row(design, looks[-1]).startswith("mine:Frontier & ")
    assert f"ended after {looks[-1].seeds} " in methods(design, looks[-1], "")


@pytest.fixture(scope="module")
def whole(trial: Trial) -> Trial:
    return trial._replace(design=designed(trial.frames))


def test_challenges_count_equally_and_the_bodies_of_each(whole: Trial) -> None:
    weights = {cell.name: cell.weight for cell in whole.design.cells}
    bodies = [name for name in weights if name.startswith("diverse_students/")]
    assert len(weights) == 7
    assert len(bodies) == 2
    assert [weights[name] for name in bodies] == [1 / 12, 1 / 12]
    assert sum(filter(None, weights.values())) == pytest.approx(1.0)


@pytest.mark.parametrize(("measure", "column"), [(HEADLINE, "angle"), (FINAL, "end")])
def test_a_look_is_the_test_of_the_boards(whole: Trial, measure: str, column: str) -> None:
    """Stratified with least variances; slopes are parts of the weights here."""
    design, runs = whole.design, whole.runs("riac", 3)
    findings = whole.looks(runs)[0].comparisons
    found = next(f for f in findings if (f.measure, f.reference) == (measure, "random"))
    pairs, factors, least = [], [], []
    for cell in design.cells:
        there = in_cell(whole.released, cell.key)
        mine, theirs = in_cell(runs, cell.key), there[there["teacher"] == "random"]
        sides = (rows.set_index("run_id")[column] for rows in (mine, theirs))
        pairs.append((next(sides).rename(lambda name: f"new {name}"), next(sides)))
        least.append(least_variance(describe(rows) for _, rows in there.groupby("teacher")[column]))
        factors.append(float(cell.weight or 0.0) * cell.spread(measure).slope)
    test = stratified(pairs, factors, least)
    assert found.value == pytest.approx(sum(factors) * test.difference)
    reach = found.value - found.low
    error = sum(factors) * test.difference / test.t
    bound = design.rule("random", moments_of(whole.released, "random", design.keys).runs, measure).lower[0]
    quantile = stats.t.isf(stats.norm.sf(bound), test.degrees_of_freedom)
    assert reach == pytest.approx(quantile * error)


def test_the_end_is_judged_by_twice_the_margin_and_ends_no_trial(trial: Trial) -> None:
    assert [trial.design.margin_of(measure) for measure in trial.design.axes] == [2.5, 5.0]
    runs = trial.runs("random", 3)
    looks = [trial.looks(runs.assign(end=runs["end"] + shift))[0] for shift in (0.0, 60.0)]
    assert looks[0].ending == looks[1].ending
    assert looks[0].settled[:2] == looks[1].settled[:2]
    assert [each.verdict for each in looks[1].settled[2:]] == [TrialVerdict.BETTER] * 2


def test_a_design_of_before_keeps_its_weights_and_its_axis(trial: Trial) -> None:
    kept = trial.design.to_dict()
    for cell in kept["cells"]:
        for name in ("weight", "least", "end"):
            del cell[name]
    design = Design.of(kept, "trial.json")
    assert design.axes == (HEADLINE,)
    assert design.estimand().weights.tolist() == [0.5, 0.5]
    assert not design.estimand().least.any()
    looks = completed_looks(design, trial.released, trial.runs(design.best, 5, points=12.0))
    assert len(looks[-1].settled) == 2
    assert "in the end" not in sentence(design, looks[-1])


def test_trials_by_which_teachers_joined_are_against_the_core() -> None:
    """Those that joined lite-2 with seeds of their own; ACCEL's trial was decided at its first look."""
    found = {design.teacher: (design, look) for design, look in joined_trials(find_baseline("lite-2"))}
    assert {"perm:budget=2000000", "spgl:budget=2000000", "traced:budget=2000000"} < set(found)
    assert not {"random", "sobol", "accel:budget=2000000"} & set(found)
    assert {design.references for design, _ in found.values()} == {("random", "covar_gmm")}
    design, look = found["accel:budget=2000000:score=mna"]
    assert (look.seeds, look.ending, design.seeds[0]) == (3, TrialEnding.DECIDED, 35)
    assert "; beside Covar-GMM worse (sooner" in look_line(look)
    assert joined_trials(find_baseline("simulated-1")) == []
