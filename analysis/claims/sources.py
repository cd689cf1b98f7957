"""Results that statements of claims are held against: the paper's tables, or the runs of a root."""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data import columns
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import amount
from analysis.measures import pooling
from analysis.measures.tested import (
    PAPERS,
    Seeds,
    compared,
    compared_over_strata,
    mean_over_strata,
    seeds_to_pair,
)
from analysis.names import label, title
from analysis.statistics import (
    Comparison,
    Description,
    describe,
    least_variance,
    mean_percent_interval,
    percent_interval,
    stratum_weights,
    welch_from_statistics,
)
from analysis.statistics.samples import bounded_interval, mean_interval_of
from tma_ray.benchmark import PAPER_STEPS, PaperResult, paper_results
from tma_ray.benchmark.claims import Reading
from tma_ray.benchmark.experiments import TEACHERS
from tma_ray.results import BOX2D, SIMULATED
from tma_ray.support.component_names import base_name


@dataclass(frozen=True, eq=False)
class Sample:
    """Results for one reading.

    Attributes:
        description: n, mean and std of mastered tasks, in per cent; of runs the mean is that of the strata.
        strata: values of each body and student, one per run, by run id; none of published results.
        seeds: seeds of the runs that are paired by them, by run id.
        least: least variance of a teacher's runs that counts in each stratum.
    """

    description: Description
    strata: Mapping[str, pd.Series] = field(default_factory=dict)
    seeds: Seeds = field(default_factory=dict)
    least: Mapping[str, float] = field(default_factory=dict)

    @property
    def runs(self) -> frozenset[object]:
        """Ids of the runs; none of published results."""
        return frozenset(run for values in self.strata.values() for run in values.index)

    @property
    def best(self) -> float:
        """Highest value of a run; NaN of published results."""
        return max((float(values.max()) for values in self.strata.values()), default=math.nan)

    def interval(self) -> tuple[float, float]:
        """Return the 95 % confidence interval of the mean, within 0 and 100.

        Student's over strata, with the least variances of the place, as boards have them; where no teacher
        there has any spread, the exact one of `bounded_interval`.
        """
        if not self.strata:
            return mean_percent_interval(self.description)
        samples, weights = list(self.strata.values()), stratum_weights([0] * len(self.strata))
        described = [describe(values) for values in samples]
        if self.seeds or min(each.n for each in described) < 2:
            mean = mean_over_strata(samples, weights, self.seeds)
            return percent_interval(mean.difference, mean.high - mean.difference)
        variances = [
            max(each.std**2, self.least.get(name, 0.0))
            for name, each in zip(self.strata, described, strict=True)
        ]
        if not any(variances):
            return bounded_interval(self.description.mean, min(each.n for each in described) * len(described))
        return mean_interval_of(self.description.mean, weights, variances, [each.n for each in described])

    def test(self, other: "Sample") -> Comparison:
        """Return the comparison with another sample, within the bodies and students that both have.

        Of published results by their means and standard deviations.
        """
        if not (self.strata and other.strata):
            return welch_from_statistics(self.description, other.description)
        seeds = {**self.seeds, **other.seeds}
        pairs = [(self.strata[name], other.strata[name]) for name in self.strata if name in other.strata]
        if len(pairs) == 1:
            return compared(*pairs[0], seeds)
        return compared_over_strata(pairs, stratum_weights([0] * len(pairs)), seeds)

    def times(self, factor: float) -> "Sample":
        """Return the sample with its values times a factor, as runs of their own."""
        own = self.description
        strata = {
            name: (factor * values).rename(lambda run: (factor, run)) for name, values in self.strata.items()
        }
        seeds: dict[Hashable, Hashable] = {(factor, run): seed for run, seed in self.seeds.items()}
        return Sample(Description(own.n, factor * own.mean, factor * own.std), strata, seeds)


class Source(Protocol):
    """Source of the results that statements of claims refer to."""

    def sample(self, reading: Reading) -> Sample | None:
        """Return the results of `reading`; None if they are missing or incomplete."""

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers that have results where `reading` is read."""

    def elsewhere(self, reading: Reading) -> str:
        """Return the conditions of its results that are not the paper's, in words; empty if they are."""


USUAL = "the paper's bodies, students and test tasks"
"""Conditions that have no words of their own."""


class PaperSource:
    """The paper's tables; they hold final results, and single bodies of Parkour only."""

    def sample(self, reading: Reading) -> Sample | None:
        """Return n, mean and std of the entry, None where the tables have none."""
        entries = [result for result in _entries(reading) if result.teacher == reading.teacher]
        if reading.share < 1 or not entries:
            return None
        entry = max(entries, key=lambda result: result.seeds)
        return Sample(Description(entry.seeds, entry.mean, entry.std))

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers that have an entry there."""
        return sorted({result.teacher for result in _entries(reading)})

    def elsewhere(self, _reading: Reading) -> str:
        """Return nothing: these are the paper's conditions."""
        return ""


class RootSource:
    """Complete pools of the runs of one root; Random counts at every level.

    Results under several conditions, such as two budgets or students, are never held against each other:
    in each environment those that complete the most pools count, and of several the largest budget.

    Attributes:
        note: conditions that count, and those that do not, in words; empty where all are alike.
    """

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._complete = cache(self._complete_at)
        present = frames.cells[["environment", "challenge"]].drop_duplicates()
        self._present = set(present.itertuples(index=False, name=None))
        tables = {name: self._pooled(name) for name in sorted(set(present["environment"]))}
        self._conditions, self.note = _chosen_conditions({n: t for n, t in tables.items() if len(t)})
        self._elsewhere = {
            environment: _elsewhere(tables[environment], conditions)
            for environment, conditions in self._conditions.items()
        }

    def sample(self, reading: Reading) -> Sample | None:
        """Return the runs of the reading; None unless its pool is complete."""
        return self._at(reading).get(reading.teacher)

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers that have complete results there."""
        return sorted(self._at(reading))

    def elsewhere(self, reading: Reading) -> str:
        """Return the budget and the students of its results if they are not the paper's; else nothing."""
        return self._elsewhere.get(reading.environment, "")

    def _at(self, reading: Reading) -> Mapping[str, Sample]:
        if (reading.environment, reading.challenge) not in self._present:
            return {}
        place = [reading.challenge, reading.level.value]
        place += [reading.embodiment] if reading.embodiment else []
        found = self._complete(reading.environment, reading.share, bool(reading.embodiment))
        return found.get(tuple(place), {})

    def _runs(self, environment: str, share: float) -> pd.DataFrame:
        """Return the runs of the paper's teachers in an environment after a share of the budget."""
        runs = pooling.runs_after(self._frames, share, training=share == 1)  # of which the page shows more
        return runs[(runs["environment"] == environment) & runs["teacher"].isin(TEACHERS)]

    def _pooled(self, environment: str, share: float = 1.0, by: Sequence[str] = ()) -> pd.DataFrame:
        """Return the result of each pool."""
        return pooling.pooled(self._runs(environment, share), [PAPERS], by=by)

    def _complete_at(
        self, environment: str, share: float, by_body: bool
    ) -> dict[tuple[str, ...], dict[str, Sample]]:
        """Return the complete results after a share of the budget, by challenge, level, body and teacher."""
        if environment not in self._conditions:  # no run of the paper's teachers has begun
            return {}
        by = ["embodiment"] if by_body else []
        runs, table = self._runs(environment, share), self._pooled(environment, share, by)
        counted = table["missing"] == ""
        for column, value in self._conditions[environment].items():
            counted &= table[str(column)].isna() if pd.isna(value) else table[str(column)] == value
        labels = (runs["embodiment"].astype(str) + "/" + runs["student"].astype(str)).to_numpy(object)
        values = pd.Series(runs[PAPERS].to_numpy(float), runs["run_id"].to_numpy(object))
        places: dict[tuple[str, ...], dict[str, Sample]] = {}
        seeds = seeds_to_pair(runs)
        pools = runs.groupby([*columns.POOLED, *by], dropna=False, sort=True).ngroup().to_numpy()
        for number, row in table[counted].sort_values("n", kind="stable").to_dict("index").items():
            mine = np.flatnonzero(pools == number)
            place = tuple(str(row[column]) for column in ("challenge", "expert_knowledge", *by))
            if row["engine"] == BOX2D and place[-1] == pooling.RELEASED_BIPEDAL:
                place = (*place[:-1], pooling.BIPEDAL)
            sample = _sample(labels[mine], values.iloc[mine], seeds)
            places.setdefault(place, {})[str(row["teacher"])] = sample
        return {place: _with_least(samples) for place, samples in places.items()}


def _sample(labels: NDArray[np.object_], values: pd.Series, seeds: Seeds) -> Sample:
    """Return the sample of a pool, of values by run id, each of the body and student of its label."""
    there = values.notna().to_numpy()
    strata = {str(name): values[there & (labels == name)] for name in sorted(set(labels))}
    weights = stratum_weights([0] * len(strata))
    mean = sum(w * float(each.mean()) for w, each in zip(weights, strata.values(), strict=True))
    whole = describe(values)
    own = {run: seeds[run] for run in values.index[there] if run in seeds}
    return Sample(Description(whole.n, mean, whole.std), strata, own)


def _with_least(samples: Mapping[str, Sample]) -> dict[str, Sample]:
    """Return the samples of a place, by teacher, with the least variances of its strata."""
    groups: dict[str, list[pd.Series]] = {}
    for sample in samples.values():
        for name, values in sample.strata.items():
            groups.setdefault(name, []).append(values)
    least = {name: least_variance(map(describe, values)) for name, values in groups.items()}
    return {teacher: replace(sample, least=least) for teacher, sample in samples.items()}


def _chosen_conditions(places: Mapping[str, pd.DataFrame]) -> tuple[dict[str, pd.Series], str]:
    """Return the conditions by which claims about each environment are judged, and words on the others.

    Args:
        places: results of `pooling.pooled` by environment.
    """
    chosen, sentences = {}, []
    for environment, pools in places.items():
        complete = pools.assign(complete=pools["missing"] == "")
        complete = complete[complete["steps"].notna()]
        counts = complete.groupby(columns.CONDITIONS, dropna=False)["complete"].sum().reset_index()
        if counts.empty:
            continue
        ordered = counts.sort_values(["complete", "steps"], ascending=False, kind="stable")
        chosen[environment] = ordered.iloc[0][columns.CONDITIONS]
        if len(ordered) == 1:
            continue
        told = pooling.varying(ordered)
        own, *others = (
            ", ".join(pooling.condition_words(row, told)) or USUAL for _, row in ordered.iterrows()
        )
        about = f" about {title('environment', environment)}" if len(places) > 1 else ""
        apart = " and of ".join(others)
        sentences.append(f"Claims{about} are judged by results of {own} alone; apart stand those of {apart}.")
    return chosen, " ".join(sentences)


def _elsewhere(table: pd.DataFrame, conditions: pd.Series) -> str:
    """Return the budget and the students of results if they are not the paper's, in words; else nothing."""
    if conditions["engine"] == SIMULATED:
        return "simulated students"
    if conditions["steps"] == PAPER_STEPS and not conditions["variant"]:
        return ""
    own = table[(table["steps"] == conditions["steps"]) & (table["variant"] == conditions["variant"])]
    students = {student for pool in own["pool"].unique() for _, student in pooling.parts_of(pool)}
    named = " and ".join(sorted({label(base_name(student)) for student in students}))
    return f"{amount(conditions['steps'])} steps of {named}"


def _entries(reading: Reading) -> list[PaperResult]:
    wanted = (reading.environment, reading.challenge, reading.level)
    return [
        result
        for result in paper_results()
        if (result.environment, result.challenge, result.expert_knowledge) == wanted
        and (not reading.embodiment or result.embodiments == (reading.embodiment,))
        and not (result.doubt and not is_baseline(result.teacher))
    ]
