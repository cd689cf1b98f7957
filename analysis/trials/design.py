"""The design of a trial: what is fixed before its first run, from what was released."""

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
from analysis.data.columns import CELL
from analysis.data.frames import Frames
from analysis.data.reference import BASELINE, is_baseline
from analysis.measures.run_measures import NOT_FINITE, run_measures
from analysis.measures.tested import FINAL, HEADLINE
from analysis.statistics import Scale, describe, least_variance, stratum_weights
from analysis.statistics.power import POWER
from analysis.statistics.samples import deviations, negligible
from analysis.trials import rules
from analysis.trials.boundaries import crossing
from tma_ray.support.component_names import nearest
from tma_ray.support.decoding import decode_json
from tma_ray.support.texts import counted
from tma_ray.tasks import KnowledgeLevel

SCALES = {HEADLINE: Scale.ARCSINE, FINAL: Scale.PERCENT}
"""Measures of a trial, in per cent, and the scales on which they are tested: the one that it is designed for,
whose spread grows with its mean in per cent, and the one that is reported beside."""

AXES = tuple(SCALES)
"""Those measures."""

SCALED = {HEADLINE: "angle", FINAL: "end"}
"""Columns of `ended_runs` with the measures on the scales on which they are tested."""

MARGIN = 2.5
"""Difference in points of `HEADLINE` that does not matter. Mastery grows about evenly over a run, so that its
mean over the budget is half of its end: this is half of the 5 points by which ends are judged."""

CHALLENGE = 2
"""Number of the columns of `CELL` that name a challenge; its cells share the weight of one."""

ERRORS = (0.05, 0.045, 0.04, 0.035, 0.03, 0.025, 0.02, 0.015, 0.01)
"""Errors to spend: a design has the largest whose verdicts are wrong in at most `ERROR` of trials."""

TRIALS = 4_000
"""Simulated trials behind that choice."""


@dataclass(frozen=True)
class Spread:
    """Spread of a measure between the runs of a release in a cell, on the scale on which it is tested.

    Attributes:
        slope: points of the measure per unit of that scale, at the mean of the release.
        deviation: standard deviation of a run, pooled over the release's teachers.
        least: least variance of a teacher's runs that counts, of `statistics.least_variance`.
    """

    slope: float
    deviation: float
    least: float


@dataclass(frozen=True)
class TrialCell:
    """A cell of a trial.

    Attributes:
        name: name of it: the challenge, with the body where the release has it with several.
        environment: its name.
        challenge: its name.
        embodiment: body.
        student: algorithm.
        expert_knowledge: level offered.
        slope: points of `HEADLINE` per radian of its arcsine, at the mean of the release.
        deviation: standard deviation of a run on the arcsine scale, rad, pooled over the release's teachers.
        hours: median hours of a run in the release; 0 if unknown.
        weight: weight in the mean over cells; None in designs of before, whose cells have equal weights.
        least: least variance of a teacher's runs that counts, rad².
        end: spread of `FINAL`; None in designs of before, which report `HEADLINE` alone.
    """

    name: str
    environment: str
    challenge: str
    embodiment: str
    student: str
    expert_knowledge: str
    slope: float
    deviation: float
    hours: float
    weight: float | None = None
    least: float = 0.0
    end: Spread | None = None

    def spread(self, measure: str) -> Spread:
        """Return the spread of one of `AXES` that the design has."""
        if measure == FINAL:
            assert self.end is not None, f"no {FINAL} in the design of {self.name}"
            return self.end
        return Spread(self.slope, self.deviation, self.least)

    @property
    def place(self) -> tuple[str, ...]:
        """Values of `CELL`."""
        return tuple(getattr(self, name) for name in CELL)


@dataclass(frozen=True)
class Design:
    """Design of a trial, fixed beforehand.

    Attributes:
        teacher: its canonical name.
        release: name of the release it is compared with.
        release_digest: SHA-256 of the runs of the release that it is compared with.
        best: teacher of the release with the highest mean of `HEADLINE`, other than Random.
        candidates: number of teachers that it was chosen among.
        cells: cells, in the order in which they are run.
        seeds: seeds of the new teacher, none of which those runs have.
        margin: difference in points of `HEADLINE` that does not matter; see `margin_of`.
        error: error that is spent, of both comparisons together; at most `ERROR`, and less where simulated
            trials with the release's residuals need it.
        simulated_error: share of those trials with a wrong verdict, the largest over true differences.
        looks: seeds of every cell at each look.
        measure: column of `run_measures`.
        runs: SHA-256 of the ids of all runs: another source or setting of the teacher is another trial.
    """

    teacher: str
    release: str
    release_digest: str
    best: str
    candidates: int
    cells: tuple[TrialCell, ...]
    seeds: tuple[int, ...]
    margin: float = MARGIN
    error: float = rules.ERROR
    simulated_error: float = 0.0
    looks: tuple[int, ...] = rules.LOOKS
    measure: str = HEADLINE
    runs: str = ""

    @classmethod
    def of(cls, content: Mapping[str, Any], where: str) -> "Design":
        """Return the design of a trial file; `DamagedFileError` where it is not what was written."""
        return decode_json(json.dumps(content), cls, where)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)

    @property
    def references(self) -> tuple[str, str]:
        """Teachers that the new one is compared with."""
        return BASELINE, self.best

    @property
    def axes(self) -> tuple[str, ...]:
        """Those of `AXES` that it has, the one that it is made for first."""
        return AXES if all(cell.end for cell in self.cells) else AXES[:1]

    def estimand(self, measure: str = HEADLINE) -> rules.Estimand:
        """Return the mean over cells of one of `axes`: challenges count equally, and the bodies of each."""
        spreads = [cell.spread(measure) for cell in self.cells]
        equal = 1 / len(self.cells)
        return rules.Estimand(
            np.array([equal if cell.weight is None else cell.weight for cell in self.cells]),
            np.array([spread.slope for spread in spreads]),
            np.array([spread.least for spread in spreads]),
        )

    def margin_of(self, measure: str) -> float:
        """Return the difference in points of one of `axes` that does not matter; see `MARGIN`."""
        return 2 * self.margin if measure == FINAL else self.margin

    @property
    def places(self) -> list[tuple[str, ...]]:
        """Place of each cell."""
        return [cell.place for cell in self.cells]

    def rule(self, reference: str, runs: rules.Floats, measure: str = HEADLINE) -> rules.Rule:
        """Return the rule of the comparison with one of `references`, of `runs` in each cell (cells,)."""
        candidates = 1 if is_baseline(reference) else self.candidates
        fractions = rules.planned_fractions(self.looks, self.estimand(measure).factors, runs)
        margin, error = self.margin_of(measure), self.error / rules.COMPARISONS
        return rules.Rule(self.looks, fractions, margin, candidates, error)

    def is_asked_for(self, teacher: str, release: str, cells: Collection[str], margin: float) -> bool:
        """True if it is the design of a trial of `teacher` against `release`, in cells of these names."""
        own = self.teacher, self.release, {cell.name for cell in self.cells}, self.margin
        return own == (teacher, release, set(cells), margin)

    def renewed(self, released: pd.DataFrame) -> "Design":
        """Return it with the digest of the runs in `released` that it is compared with; see `released_runs`.

        A release that has grown by runs of others is the same to a trial.
        """
        return replace(self, release_digest=_digest(released, self.references, self.places))

    def differing(self, other: "Design") -> list[str]:
        """Return the settings in which another design differs, in words."""
        mine, theirs = self.to_dict(), other.to_dict()
        words = [
            f"{name}: {mine[name]!r:.80}, not {theirs[name]!r:.80}"
            for name in mine
            if name not in {"error", "simulated_error", "runs"} and mine[name] != theirs[name]
        ]
        if not words and self.runs != other.runs:
            words = [f"runs: the source of {self.teacher} or a setting of its runs is another one"]
        return words


def released_runs(frames: Frames) -> pd.DataFrame:
    """Return the runs of a release that a trial is compared with: of `ended_runs`, with finite returns."""
    return ended_runs(frames).dropna(subset=["angle"])


def ended_runs(frames: Frames) -> pd.DataFrame:
    """Return the runs that have ended: `CELL`, teacher, run_id, seed, `AXES` and `SCALED` columns.

    All measures of a run whose returns are not finite are NaN.
    """
    cells = frames.cells[[*CELL, "teacher", "seed", "run_id"]].drop_duplicates()
    measures = run_measures(frames, training=False)
    ended = measures["reason"].isin(["", NOT_FINITE])
    rows = cells.merge(measures.loc[ended, ["run_id", *AXES]], on="run_id")
    scaled = {column: SCALES[measure].of(rows[measure]) for measure, column in SCALED.items()}
    return rows.assign(**scaled).astype(dict.fromkeys([*CELL, "teacher"], str))


def in_cell(runs: pd.DataFrame, place: tuple[str, ...]) -> pd.DataFrame:
    """Return those of `runs` in the cell at a place, values of `CELL`."""
    return runs[(runs[CELL] == list(place)).all(axis=1)]


def moments_of(
    runs: pd.DataFrame, teacher: str, places: Sequence[tuple[str, ...]], measure: str = HEADLINE
) -> rules.Moments:
    """Return the moments of a teacher's `runs` in each cell; NaN of a sample that is too small."""
    own = runs[runs["teacher"] == teacher]
    samples = [in_cell(own, place)[SCALED[measure]].to_numpy(float) for place in places]
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [sample.mean() if sample.size else np.nan for sample in samples]
        variances = [sample.var(ddof=1) if sample.size > 1 else np.nan for sample in samples]
    return rules.Moments(np.array(means), np.array(variances), np.array([float(s.size) for s in samples]))


def make_design(
    teacher: str,
    baseline: Baseline,
    frames: Frames,
    margin: float = MARGIN,
    wanted: Collection[str] = (),
    looks: tuple[int, ...] = rules.LOOKS,
) -> Design:
    """Return the design of a trial against a release.

    Its error is the largest of `ERRORS` by which simulated verdicts are wrong rarely enough: Student's
    quantiles of few and skewed values spend more than they should, as trials over one cell show.

    Args:
        teacher: canonical name of the new teacher.
        baseline: the release.
        frames: its frames.
        margin: difference in points that does not matter.
        wanted: names of cells: the challenge, with the body where it has several; all by default.
        looks: seeds of every cell at each look.

    Raises:
        ValueError: an unknown cell, too few runs of Random or of others to compare with, no spread between
            seeds, or verdicts that would be wrong too often.
    """
    released, core = released_runs(frames), baseline.manifest.core
    released = released[released["teacher"] != teacher]
    cells = frames.cells[frames.cells["campaign"].isin(core)] if core else frames.cells
    places = _chosen(cells, wanted)
    best, candidates = _best(released, list(places.values()), baseline.manifest.name)
    first = int(released.loc[released["teacher"].isin([BASELINE, best]), "seed"].max()) + 1
    seeds = tuple(range(first, first + looks[-1]))
    chosen = _cells(places, released, frames)
    name = baseline.manifest.name
    if not any(cell.deviation for cell in chosen):
        raise ValueError(f"{name} has no spread between seeds in these cells: choose others or more of them")
    design = Design(teacher, name, "", best, candidates, chosen, seeds, margin, looks=looks)
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


def _chosen(cells: pd.DataFrame, wanted: Collection[str]) -> dict[str, tuple[str, ...]]:
    """Return the places of Random at the highest level of knowledge that each has, by name."""
    own = cells[cells["teacher"].map(lambda name: is_baseline(str(name)))]
    found = {tuple(map(str, row)) for row in own[CELL].itertuples(index=False)}
    ordered = sorted(found, key=lambda place: (place[:-1], KnowledgeLevel(place[-1]).rank))
    places = {place[:-1]: place for place in ordered}  # the last of each, which is the highest
    challenges = [place[:2] for place in places.values()]
    known = {
        place[1] if challenges.count(place[:2]) == 1 else f"{place[1]}/{place[2]}": place
        for place in places.values()
    }
    for name in wanted:
        if name not in known:
            raise ValueError(
                f"the release has no cell {name!r}: {nearest(name, known)}it has {', '.join(known)}"
            )
    return {name: place for name, place in known.items() if not wanted or name in wanted}


def _cells(
    places: Mapping[str, tuple[str, ...]], released: pd.DataFrame, frames: Frames
) -> tuple[TrialCell, ...]:
    """Return the cells in falling order of signal to noise per core-hour.

    That is the variance between the release's teachers, without what their seeds add to it, over the variance
    of a run, for each hour of a run.
    """
    found, weights = [], _weights(list(places.values()))
    for (name, place), weight in zip(places.items(), weights, strict=True):
        rows = in_cell(released, place)
        groups = rows.groupby("teacher")["angle"]
        own, end = (_spread(rows, measure) for measure in AXES)
        hours = frames.run_hours.reindex(rows["run_id"].unique()).median()
        hours = 0.0 if np.isnan(hours) else float(hours)
        noise = own.deviation**2
        signal = max(float(groups.mean().var()) - noise * float((1 / groups.size()).mean()), 0.0)
        cell = TrialCell(
            name,
            **dict(zip(CELL, place, strict=True)),
            slope=own.slope,
            deviation=own.deviation,
            hours=hours,
            weight=weight,
            least=own.least,
            end=end,
        )
        ratio = signal / noise if noise else np.inf
        found.append((ratio / (hours or 1.0), cell))
    return tuple(cell for _, cell in sorted(found, key=itemgetter(0), reverse=True))


def _weights(places: Sequence[tuple[str, ...]]) -> list[float]:
    """Return the weight of each cell: equal for challenges, and for the cells of one."""
    weights = stratum_weights([place[:CHALLENGE] for place in places])
    return [weight / sum(weights) for weight in weights]


def _spread(rows: pd.DataFrame, measure: str) -> Spread:
    """Return the spread of a measure between the runs of a cell."""
    groups = rows.groupby("teacher")[SCALED[measure]]
    sizes, means = groups.size(), groups.mean()
    variances = groups.var().mask(negligible(groups.std(), means), 0.0)
    deviation = float(np.sqrt((variances * (sizes - 1)).sum() / (sizes - 1).sum()))
    arcsine = SCALES[measure] is Scale.ARCSINE
    slope = 100 * float(np.sin(2 * means.mean())) if arcsine else 1.0
    return Spread(slope, deviation, least_variance(describe(values) for _, values in groups))


def _candidates(released: pd.DataFrame, places: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the teachers but Random with as many runs in each cell as that has."""
    needed = moments_of(released, BASELINE, places).runs
    return [
        teacher
        for teacher in released["teacher"].unique()
        if not is_baseline(teacher) and (moments_of(released, teacher, places).runs >= needed).all()
    ]


def _best(released: pd.DataFrame, places: Sequence[tuple[str, ...]], name: str) -> tuple[str, int]:
    """Return the best teacher but Random over cells, and how many have as many runs."""
    needed = moments_of(released, BASELINE, places).runs
    if needed.min() < 3:
        runs = counted(int(needed.min()), "run")
        raise ValueError(f"{name} has {runs} of Random in a cell: a trial needs 3")
    areas, weights = released.groupby(["teacher", *CELL])[HEADLINE].mean(), _weights(places)
    means = {
        teacher: float(np.dot(weights, [areas[teacher, *place] for place in places]))
        for teacher in _candidates(released, places)
    }
    if not means:
        raise ValueError(f"{name} has no teacher with as many runs as Random in these cells")
    return max(means, key=lambda teacher: means[teacher]), len(means)


def _digest(released: pd.DataFrame, teachers: Sequence[str], places: Sequence[tuple[str, ...]]) -> str:
    """Return the SHA-256 of the runs of some teachers in the cells at some places, and their results."""
    own = released[released["teacher"].isin(teachers)]
    rows = pd.concat([in_cell(own, place) for place in places])
    lines = sorted(
        f"{run_id} {area:.6f}" for run_id, area in zip(rows["run_id"], rows[HEADLINE], strict=True)
    )
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def setting_of(design: Design, released: pd.DataFrame, measure: str = HEADLINE) -> rules.Setting:
    """Return a design for simulated trials, with residuals of the teachers that the best is chosen among."""
    teachers = [BASELINE, *_candidates(released, design.places)]
    residuals = []
    for place in design.places:
        groups = in_cell(released, place).groupby("teacher")[SCALED[measure]]
        samples = [groups.get_group(teacher).to_numpy(float) for teacher in teachers]
        residuals.append(tuple(deviations(each) * np.sqrt(each.size / (each.size - 1)) for each in samples))
    runs = moments_of(released, BASELINE, design.places).runs
    both = tuple(design.rule(reference, runs, measure) for reference in design.references)
    return rules.Setting(both, design.estimand(measure), tuple(residuals), runs)


def detectable(design: Design, reference: str, runs: rules.Floats) -> float:
    """Return the difference in points that a trial finds with probability `POWER`, at any of its looks.

    For normal runs with the release's standard deviations.
    """
    rule, expected = design.rule(reference, runs), planned(design, runs)
    freedoms = [float(each.freedom) for each in expected]
    bounds = [
        float(rules.quantile(np.array(f), bound)) for f, bound in zip(freedoms, rule.lower, strict=True)
    ]
    information = [float(each.error) ** -2 for each in expected]
    scale = float(expected[-1].error)

    def excess(shift: float) -> float:
        return sum(crossing(bounds, information, shift * scale)) - POWER

    return float(optimize.brentq(excess, 0.0, 50.0)) * scale


def planned(design: Design, runs: rules.Floats, measure: str = HEADLINE) -> list[rules.Difference]:
    """Return the information of each look if the new teacher is like the reference."""
    variance = np.array([cell.spread(measure).deviation ** 2 for cell in design.cells])
    reference = rules.Moments(np.zeros_like(variance), variance, runs)
    teachers = [replace(reference, runs=np.full_like(variance, seeds)) for seeds in design.looks]
    return [rules.difference(teacher, reference, design.estimand(measure)) for teacher in teachers]
