"""Designs of trials, computed from the results of a release and fixed before the first run."""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize

from analysis.baselines.catalogue import Baseline
from analysis.data.columns import CELL_COLUMNS
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline, random_cells
from analysis.measures.run_measures import NOT_FINITE, run_measures
from analysis.measures.tested import AREA_MARGIN, FINAL, HEADLINE
from analysis.statistics import Scale, describe, least_variance, stratum_weights
from analysis.statistics.power import POWER
from analysis.statistics.samples import deviations, negligible
from analysis.trials import rules
from analysis.trials.boundaries import crossing
from tma_ray.support.decoding import decode_json
from tma_ray.support.texts import counted
from tma_ray.support.validation import check_known

SCALES = {HEADLINE: Scale.ARCSINE, FINAL: Scale.PERCENT}
"""Scale on which each measure of a trial is tested: first the measure that the trial is designed for, whose
spread grows with its mean, then the one that is reported beside it."""

AXES = tuple(SCALES)  # measures that a trial compares

SCALED = {HEADLINE: "angle", FINAL: "end"}
"""Columns of `ended_runs` with the measures on the scales of their tests."""

CHALLENGE = 2  # number of leading columns of `CELL_COLUMNS` that identify a challenge

ERRORS = (0.05, 0.045, 0.04, 0.035, 0.03, 0.025, 0.02, 0.015, 0.01)
"""Candidate errors to spend; a design uses the largest with wrong verdicts in at most `ERROR` of trials."""

TRIALS = 4_000  # number of trials simulated to choose the error


@dataclass(frozen=True)
class Spread:
    """Spread of a measure among a release's runs in a cell, on the scale of its test."""

    slope: float  # derivative of the measure (points) with respect to its scaled value, at the release's mean
    deviation: float  # standard deviation over runs, pooled over the release's teachers
    least: float  # `statistics.least_variance` of the release's teachers


@dataclass(frozen=True)
class TrialCell:
    """Cell of a trial, with its weight, its cost, and the spread of results in the release."""

    name: str  # name by `reference.random_cells`
    environment: str
    challenge: str
    embodiment: str
    student: str
    expert_knowledge: str
    slope: float  # derivative of `HEADLINE` (points) with respect to its arcsine (rad), at the release's mean
    deviation: float  # standard deviation over runs, pooled over the release's teachers, in rad
    hours: float  # median hours of a run in the release; 0 if unknown
    weight: float | None = None  # weight in the mean over cells; None in older designs (equal weights)
    least: float = 0.0  # `statistics.least_variance` of the release's teachers, in rad²
    end: Spread | None = None  # spread of `FINAL`; None in older designs, which report `HEADLINE` alone

    def spread(self, measure: str) -> Spread:
        """Return the spread of a measure in the cell."""
        if measure == FINAL:
            assert self.end is not None, f"no {FINAL} in the design of {self.name}"
            return self.end
        return Spread(self.slope, self.deviation, self.least)

    @property
    def key(self) -> tuple[str, ...]:
        """Values of `CELL_COLUMNS`."""
        return tuple(getattr(self, name) for name in CELL_COLUMNS)


@dataclass(frozen=True)
class Design:
    """Design of a trial, fixed before its first run."""

    teacher: str  # canonical name of the new teacher
    release: str  # name of the release with which the teacher is compared
    release_digest: str  # SHA-256 of the references' run ids and results
    best: str  # teacher of the release with the highest mean of `HEADLINE`, other than Random
    candidates: int  # number of teachers among which `best` was selected
    cells: tuple[TrialCell, ...]  # cells in the order in which the trial runs them
    seeds: tuple[int, ...]  # seeds of the new teacher, disjoint from those of the references
    margin: float = AREA_MARGIN  # equivalence margin of `HEADLINE`, in points; see `margin_of`
    error: float = rules.ERROR  # error to spend on both comparisons together, at most `rules.ERROR`
    simulated_error: float = 0.0  # share of wrong verdicts in simulations, at the worst true difference
    looks: tuple[int, ...] = rules.LOOKS  # cumulative number of the new teacher's seeds per cell at each look
    measure: str = HEADLINE  # measure that the design is made for, a column of `run_measures`
    runs: str = ""  # SHA-256 of the ids of all runs, which depend on the teacher's source and settings
    steps: int | None = None  # environment steps after which all runs are measured; None for their budgets

    @classmethod
    def of(cls, content: Mapping[str, Any], where: str) -> "Design":
        """Return the design decoded from the content of a trial file.

        Raises:
            DamagedFileError: if the content is not that of a design.
        """
        return decode_json(json.dumps(content), cls, where)

    def to_dict(self) -> dict[str, Any]:
        """Return the design as plain data."""
        return asdict(self)

    @property
    def references(self) -> tuple[str, str]:
        """Teachers with which the new one is compared."""
        return BASELINE, self.best

    @property
    def axes(self) -> tuple[str, ...]:
        """Measures that the trial compares, `HEADLINE` first."""
        return AXES if all(cell.end for cell in self.cells) else AXES[:1]

    def estimand(self, measure: str = HEADLINE) -> rules.Estimand:
        """Return the estimand of a measure, from the weights and spreads of the cells."""
        spreads = [cell.spread(measure) for cell in self.cells]
        equal = 1 / len(self.cells)
        return rules.Estimand(
            np.array([equal if cell.weight is None else cell.weight for cell in self.cells]),
            np.array([spread.slope for spread in spreads]),
            np.array([spread.least for spread in spreads]),
        )

    def margin_of(self, measure: str) -> float:
        """Return the equivalence margin of a measure, in points; that of final results is twice as wide."""
        return 2 * self.margin if measure == FINAL else self.margin

    @property
    def keys(self) -> list[tuple[str, ...]]:
        """Values of `CELL_COLUMNS` of each cell."""
        return [cell.key for cell in self.cells]

    def rule(self, reference: str, runs: rules.Floats, measure: str = HEADLINE) -> rules.DecisionRule:
        """Return the decision rule for comparing with `reference`, given its number of `runs` (cells,)."""
        candidates = 1 if is_baseline(reference) else self.candidates
        fractions = rules.planned_fractions(self.looks, self.estimand(measure).factors, runs)
        margin, error = self.margin_of(measure), self.error / rules.COMPARISONS
        return rules.DecisionRule(self.looks, fractions, margin, candidates, error)

    def is_asked_for(
        self, teacher: str, release: str, cells: Collection[str], margin: float, steps: int | None
    ) -> bool:
        """Return True if the design is for this teacher, release, cells, margin and number of steps."""
        settings = self.teacher, self.release, {cell.name for cell in self.cells}, self.margin, self.steps
        return settings == (teacher, release, set(cells), margin, steps)

    def renewed(self, released: pd.DataFrame) -> "Design":
        """Return the design with its digest recomputed from the references' runs in `released`.

        The digest ignores other runs, so a release may grow during a trial.
        """
        return replace(self, release_digest=_digest(released, self.references, self.keys))

    def differing(self, other: "Design") -> list[str]:
        """Return a phrase for each setting in which this design differs from `other`."""
        first, second = self.to_dict(), other.to_dict()
        phrases = [
            f"{name}: {first[name]!r:.80}, not {second[name]!r:.80}"
            for name in first
            if name not in {"error", "simulated_error", "runs"} and first[name] != second[name]
        ]
        if not phrases and self.runs != other.runs:
            phrases = [f"runs: the source of {self.teacher} or a setting of its runs is another one"]
        return phrases


def released_runs(frames: Frames, steps: int | None = None) -> pd.DataFrame:
    """Return the runs of a release that have ended with finite returns; see `ended_runs`."""
    return ended_runs(frames, steps).dropna(subset=["angle"])


def ended_runs(frames: Frames, steps: int | None = None) -> pd.DataFrame:
    """Return the runs that have ended, with NaN measures for those with non-finite returns.

    Args:
        frames: frames of a release or a trial.
        steps: environment steps after which runs are measured, as if they ended there; None for their
            budgets.

    Returns:
        `CELL_COLUMNS`, teacher, run_id, seed, steps (budget of the run), the measures of `AXES` and the
        columns of `SCALED`.
    """
    cells = frames.cells[[*CELL_COLUMNS, "teacher", "seed", "run_id", "steps"]].drop_duplicates()
    measures = run_measures(frames, steps, training=False)
    ended = measures["reason"].isin(["", NOT_FINITE])
    rows = cells.merge(measures.loc[ended, ["run_id", *AXES]], on="run_id")
    scaled = {column: SCALES[measure].of(rows[measure]) for measure, column in SCALED.items()}
    return rows.assign(**scaled).astype(dict.fromkeys([*CELL_COLUMNS, "teacher"], str))


def in_cell(runs: pd.DataFrame, key: tuple[str, ...]) -> pd.DataFrame:
    """Return the runs in the cell whose values of `CELL_COLUMNS` are `key`."""
    return runs[(runs[CELL_COLUMNS] == list(key)).all(axis=1)]


def moments_of(
    runs: pd.DataFrame, teacher: str, keys: Sequence[tuple[str, ...]], measure: str = HEADLINE
) -> rules.Moments:
    """Return the moments of a teacher's runs in each cell, NaN for cells with too few runs."""
    by_cell = dict(iter(runs[runs["teacher"] == teacher].groupby(CELL_COLUMNS)[SCALED[measure]]))
    samples = [by_cell.get(key, pd.Series(dtype=float)).to_numpy(float) for key in keys]
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [sample.mean() if sample.size else np.nan for sample in samples]
        variances = [sample.var(ddof=1) if sample.size > 1 else np.nan for sample in samples]
    return rules.Moments(np.array(means), np.array(variances), np.array([float(s.size) for s in samples]))


def make_design(
    teacher: str,
    baseline: Baseline,
    frames: Frames,
    margin: float = AREA_MARGIN,
    cells: Collection[str] = (),
    looks: tuple[int, ...] = rules.LOOKS,
    steps: int | None = None,
) -> Design:
    """Return the design of a trial against a release.

    Its error is the largest of `ERRORS` with wrong verdicts in at most `ERROR` of simulated trials: with few
    and skewed values, tests by Student's quantiles spend more than their nominal error, most of all with a
    single cell.

    Args:
        teacher: canonical name of the new teacher.
        baseline: release.
        frames: frames of the release.
        margin: equivalence margin, in points.
        cells: names of cells by `reference.random_cells`; all by default.
        looks: number of the new teacher's seeds per cell at each look.
        steps: environment steps after which all runs are measured; None for the budgets of the release.

    Raises:
        ValueError: if a cell is unknown, runs of a cell are not evaluated after these steps, the references
            have too few runs or no spread between seeds, or verdicts would be wrong too often.
    """
    released, name = released_runs(frames, steps), baseline.manifest.name
    released = released[released["teacher"] != teacher]
    keys = random_cells(frames.cells)
    for cell in cells:
        check_known("cell", cell, keys, f"{name} has")
    keys = {cell: key for cell, key in keys.items() if not cells or cell in cells}
    if steps is not None:
        _check_evaluated(steps, keys, frames, name)
    best, candidates = _best(released, list(keys.values()), name)
    first = int(released.loc[released["teacher"].isin([BASELINE, best]), "seed"].max()) + 1
    seeds = tuple(range(first, first + looks[-1]))
    trial_cells = _cells(keys, released, frames, steps)
    if not any(cell.deviation for cell in trial_cells):
        raise ValueError(f"{name} has no spread between seeds in these cells: choose others or more of them")
    design = Design(teacher, name, "", best, candidates, trial_cells, seeds, margin, looks=looks, steps=steps)
    design = design.renewed(released)
    for error in ERRORS:
        design = replace(design, error=error)
        setting = setting_of(design, released)
        wrong = max(
            float(rules.simulate(setting, true, TRIALS).wrong.mean()) for true in (0.0, margin, -margin)
        )
        if wrong + 2 * np.sqrt(wrong / TRIALS) <= rules.ERROR:
            return replace(design, simulated_error=wrong)
    raise ValueError(
        f"verdicts in these cells would be wrong in {100 * wrong:.1f} % of trials: choose more of them"
    )


def _check_evaluated(steps: int, keys: Mapping[str, tuple[str, ...]], frames: Frames, name: str) -> None:
    """Raise a ValueError if a run in one of the cells has no evaluation after `steps`."""
    runs = frames.cells.astype(dict.fromkeys(CELL_COLUMNS, str))
    for cell, key in keys.items():
        of_cell = frames.measured[frames.measured["run_id"].isin(in_cell(runs, key)["run_id"])]
        counts = of_cell.groupby("step")["run_id"].nunique()
        shared = [int(step) for step in counts.index[counts == counts.max()] if step > 0]
        if steps not in shared:
            others = f"it has them every {shared[0]:,} up to {shared[-1]:,}" if shared else "it has none"
            raise ValueError(
                f"{name} has no evaluations of {cell} after {steps:,} steps, where runs would be compared; "
                f"{others}"
            )


def _cells(
    keys: Mapping[str, tuple[str, ...]], released: pd.DataFrame, frames: Frames, steps: int | None
) -> tuple[TrialCell, ...]:
    """Return the cells of a trial, sorted by signal-to-noise ratio per core-hour, highest first.

    The signal is the variance between the release's teachers, less the part due to seeds; the noise is the
    variance of a run.
    """
    ranked, weights = [], _weights(list(keys.values()))
    for (name, key), weight in zip(keys.items(), weights, strict=True):
        rows = in_cell(released, key)
        groups = rows.groupby("teacher")["angle"]
        area, end = (_spread(rows, measure) for measure in AXES)
        trained = 1.0 if steps is None else steps / rows["steps"].astype(float)
        hours = (rows["run_id"].map(frames.run_hours) * trained).median()
        hours = 0.0 if np.isnan(hours) else float(hours)
        noise = area.deviation**2
        signal = max(float(groups.mean().var()) - noise * float((1 / groups.size()).mean()), 0.0)
        cell = TrialCell(
            name,
            **dict(zip(CELL_COLUMNS, key, strict=True)),
            slope=area.slope,
            deviation=area.deviation,
            hours=hours,
            weight=weight,
            least=area.least,
            end=end,
        )
        ratio = signal / noise if noise else np.inf
        ranked.append((ratio / (hours or 1.0), cell))
    return tuple(cell for _, cell in sorted(ranked, key=itemgetter(0), reverse=True))


def _weights(keys: Sequence[tuple[str, ...]]) -> list[float]:
    """Return cell weights that sum to 1, equal for all challenges and for the cells within a challenge."""
    weights = stratum_weights([key[:CHALLENGE] for key in keys])
    return [weight / sum(weights) for weight in weights]


def _spread(rows: pd.DataFrame, measure: str) -> Spread:
    """Return the spread of a measure among the runs of one cell."""
    groups = rows.groupby("teacher")[SCALED[measure]]
    sizes, means = groups.size(), groups.mean()
    variances = groups.var().mask(negligible(groups.std(), means), 0.0)
    deviation = float(np.sqrt((variances * (sizes - 1)).sum() / (sizes - 1).sum()))
    arcsine = SCALES[measure] is Scale.ARCSINE
    slope = 100 * float(np.sin(2 * means.mean())) if arcsine else 1.0
    return Spread(slope, deviation, least_variance(describe(values) for _, values in groups))


def _candidates(released: pd.DataFrame, keys: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the teachers, excluding Random, with at least as many runs as Random in every cell."""
    needed = moments_of(released, BASELINE, keys).runs
    return [
        teacher
        for teacher in released["teacher"].unique()
        if not is_baseline(teacher) and (moments_of(released, teacher, keys).runs >= needed).all()
    ]


def _best(released: pd.DataFrame, keys: Sequence[tuple[str, ...]], name: str) -> tuple[str, int]:
    """Return the best teacher over all cells, excluding Random, and the number of candidates."""
    needed = moments_of(released, BASELINE, keys).runs
    if needed.min() < 3:
        runs = counted(int(needed.min()), "run")
        raise ValueError(f"{name} has {runs} of Random in a cell: a trial needs 3")
    areas, weights = released.groupby(["teacher", *CELL_COLUMNS])[HEADLINE].mean(), _weights(keys)
    means = {
        teacher: float(np.dot(weights, [areas[teacher, *key] for key in keys]))
        for teacher in _candidates(released, keys)
    }
    if not means:
        raise ValueError(f"{name} has no teacher with as many runs as Random in these cells")
    return max(means, key=lambda teacher: means[teacher]), len(means)


def _digest(released: pd.DataFrame, teachers: Sequence[str], keys: Sequence[tuple[str, ...]]) -> str:
    """Return the SHA-256 of the ids and results of the given teachers' runs in the given cells."""
    runs = released[released["teacher"].isin(teachers)]
    rows = pd.concat([in_cell(runs, key) for key in keys])
    lines = sorted(
        f"{run_id} {area:.6f}" for run_id, area in zip(rows["run_id"], rows[HEADLINE], strict=True)
    )
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def setting_of(design: Design, released: pd.DataFrame, measure: str = HEADLINE) -> rules.Setting:
    """Return the parameters for simulating trials of a design."""
    teachers = [BASELINE, *_candidates(released, design.keys)]
    residuals = []
    for key in design.keys:
        groups = in_cell(released, key).groupby("teacher")[SCALED[measure]]
        samples = [groups.get_group(teacher).to_numpy(float) for teacher in teachers]
        residuals.append(
            tuple(deviations(sample) * np.sqrt(sample.size / (sample.size - 1)) for sample in samples)
        )
    runs = moments_of(released, BASELINE, design.keys).runs
    both = tuple(design.rule(reference, runs, measure) for reference in design.references)
    return rules.Setting(both, design.estimand(measure), tuple(residuals), runs)


def detectable(design: Design, reference: str, runs: rules.Floats) -> float:
    """Return the true difference, in points, that a trial detects by its last look with power `POWER`.

    Runs are assumed normal with the release's standard deviations.
    """
    rule, expected = design.rule(reference, runs), planned(design, runs)
    bounds = [
        float(rules.quantile(estimate.freedom, bound))
        for estimate, bound in zip(expected, rule.lower, strict=True)
    ]
    information = [float(estimate.error) ** -2 for estimate in expected]
    scale = float(expected[-1].error)

    def excess(shift: float) -> float:
        return sum(crossing(bounds, information, shift * scale)) - POWER

    return float(optimize.brentq(excess, 0.0, 50.0)) * scale


def planned(design: Design, runs: rules.Floats, measure: str = HEADLINE) -> list[rules.DifferenceEstimate]:
    """Return the expected estimate at each look, for a new teacher whose results equal the reference's."""
    variance = np.array([cell.spread(measure).deviation ** 2 for cell in design.cells])
    reference = rules.Moments(np.zeros_like(variance), variance, runs)
    teachers = [replace(reference, runs=np.full_like(variance, seeds)) for seeds in design.looks]
    return [rules.difference(teacher, reference, design.estimand(measure)) for teacher in teachers]
