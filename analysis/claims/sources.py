"""Sources of results for claims: the paper's tables and the runs of a root."""

import math
from collections.abc import Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Protocol

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data import columns
from analysis.data.frames import Frames
from analysis.data.reference import is_baseline
from analysis.formatting import listed, steps_text
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
from tma_ray.support.component_names import base_name, join_name


@dataclass(frozen=True, eq=False)
class Sample:
    """Results for a reading of a claim: values of runs, or published statistics."""

    description: Description  # size, mean over strata, and standard deviation of mastered_percent
    strata: Mapping[str, pd.Series] = field(default_factory=dict)  # values of the runs, by body and student
    seeds: Seeds = field(default_factory=dict)  # seeds of paired runs, by run id
    least: Mapping[str, float] = field(default_factory=dict)  # `statistics.least_variance`, by stratum

    @property
    def runs(self) -> frozenset[object]:
        """Ids of the runs; none for published results."""
        return frozenset(run for values in self.strata.values() for run in values.index)

    @property
    def best(self) -> float:
        """Highest value of a run; NaN for published results."""
        return max((float(values.max()) for values in self.strata.values()), default=math.nan)

    def interval(self) -> tuple[float, float]:
        """Return the 95 % confidence interval of the mean, within 0 and 100.

        It is Student's interval over strata with least variances, as on leaderboards, or `bounded_interval`
        if there is no spread.
        """
        if not self.strata:
            return mean_percent_interval(self.description)
        samples, weights = list(self.strata.values()), stratum_weights([0] * len(self.strata))
        described = [describe(values) for values in samples]
        sizes = [stratum.n for stratum in described]
        if self.seeds or min(sizes) < 2:
            mean = mean_over_strata(samples, weights, self.seeds)
            return percent_interval(mean.difference, mean.high - mean.difference)
        variances = [
            max(stratum.std**2, self.least.get(name, 0.0))
            for name, stratum in zip(self.strata, described, strict=True)
        ]
        if not any(variances):
            return bounded_interval(self.description.mean, min(sizes) * len(sizes))
        return mean_interval_of(self.description.mean, weights, variances, sizes)

    def test(self, other: "Sample") -> Comparison:
        """Compare the mean with that of another sample, over common strata if both have runs."""
        if not (self.strata and other.strata):
            return welch_from_statistics(self.description, other.description)
        seeds = {**self.seeds, **other.seeds}
        pairs = [(self.strata[name], other.strata[name]) for name in self.strata if name in other.strata]
        if len(pairs) == 1:
            return compared(*pairs[0], seeds)
        return compared_over_strata(pairs, stratum_weights([0] * len(pairs)), seeds)

    def times(self, factor: float) -> "Sample":
        """Return a copy of the sample with its values multiplied by `factor`, and with new run ids."""
        n, mean, std = self.description.n, self.description.mean, self.description.std
        strata = {
            name: (factor * values).rename(lambda run: (factor, run)) for name, values in self.strata.items()
        }
        seeds: dict[Hashable, Hashable] = {(factor, run): seed for run, seed in self.seeds.items()}
        return Sample(Description(n, factor * mean, factor * std), strata, seeds)


class Source(Protocol):
    """Source of results for the statements of claims."""

    def sample(self, reading: Reading) -> Sample | None:
        """Return the results of a reading, or None if they are missing or incomplete."""

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers with results on the challenge and at the level of a reading."""

    def other_conditions(self, reading: Reading) -> str:
        """Return the conditions in which results differ from the paper's, or an empty string."""


USUAL = "the paper's bodies, students and test tasks"
"""Description of conditions for which `pooling.condition_words` has no phrases."""


class PaperSource:
    """Source backed by the paper's tables: results at the end of training, split by body only in Parkour."""

    def sample(self, reading: Reading) -> Sample | None:
        """Return the published result for a reading, or None if there is none."""
        entries = [result for result in _entries(reading) if result.teacher == reading.teacher]
        if reading.share < 1 or not entries:
            return None
        entry = max(entries, key=lambda result: result.seeds)
        return Sample(Description(entry.seeds, entry.mean, entry.std))

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers with a published result on the challenge and at the level of a reading."""
        return sorted({result.teacher for result in _entries(reading)})

    def other_conditions(self, _reading: Reading) -> str:
        """Return an empty string: all conditions are the paper's."""
        return ""


class RootSource:
    """Source backed by the runs of a results root: complete pools, with Random at every level.

    Results are used under one set of conditions, such as budget and students, in each environment: the one
    that completes the most pools, and among several the one with the largest budget. A teacher without runs
    in an environment has those with the settings of the original release (``preset=release``).

    Attributes:
        note: sentences about these conditions and settings; empty if all results are used as they are.
    """

    def __init__(self, frames: Frames) -> None:
        self._frames = frames
        self._complete = cache(self._complete_at)
        present = frames.cells[["environment", "challenge"]].drop_duplicates()
        self._present = set(present.itertuples(index=False, name=None))
        taught = frames.cells.groupby("environment", observed=True)["teacher"].unique()
        self._released = {str(name): _released_settings(set(teachers)) for name, teachers in taught.items()}
        tables = {name: self._pooled(name) for name in sorted(set(present["environment"]))}
        self._conditions, note = _chosen_conditions({n: t for n, t in tables.items() if len(t)})
        self.note = " ".join(filter(None, (note, *_settings_notes(self._released))))
        self._others = {
            environment: _other_conditions(tables[environment], conditions)
            for environment, conditions in self._conditions.items()
        }

    def sample(self, reading: Reading) -> Sample | None:
        """Return the runs pooled for `reading`, or None if some are missing."""
        return self._at(reading).get(reading.teacher)

    def teachers(self, reading: Reading) -> Sequence[str]:
        """Return the teachers with complete results on the challenge and at the level of a reading."""
        return sorted(self._at(reading))

    def other_conditions(self, reading: Reading) -> str:
        """Return the budget and students of the results if they are not the paper's, or an empty string."""
        return self._others.get(reading.environment, "")

    def _at(self, reading: Reading) -> Mapping[str, Sample]:
        if (reading.environment, reading.challenge) not in self._present:
            return {}
        key = [reading.challenge, reading.level.value]
        key += [reading.embodiment] if reading.embodiment else []
        results = self._complete(reading.environment, reading.share, bool(reading.embodiment))
        return results.get(tuple(key), {})

    def _runs(self, environment: str, share: float) -> pd.DataFrame:
        """Return the runs of the paper's teachers in an environment after a share of the budget."""
        # same arguments as pages use, to share the cached result
        runs = pooling.runs_after(self._frames, share, training=share == 1)
        runs = runs[runs["environment"] == environment]
        teachers = runs["teacher"].replace(self._released.get(environment, {}))
        return runs.assign(teacher=teachers)[teachers.isin(TEACHERS)]

    def _pooled(self, environment: str, share: float = 1.0, by: Sequence[str] = ()) -> pd.DataFrame:
        """Return the pooled results of an environment after a share of the budget."""
        return pooling.pooled(self._runs(environment, share), [PAPERS], by=by)

    def _complete_at(
        self, environment: str, share: float, by_body: bool
    ) -> dict[tuple[str, ...], dict[str, Sample]]:
        """Return the samples of complete pools by (challenge, level[, body]) and teacher."""
        if environment not in self._conditions:  # no run of the paper's teachers has started there
            return {}
        by = ["embodiment"] if by_body else []
        runs, table = self._runs(environment, share), self._pooled(environment, share, by)
        counted = table["missing"] == ""
        for column, value in self._conditions[environment].drop("variant").items():
            counted &= table[str(column)].isna() if pd.isna(value) else table[str(column)] == value
        counted &= _in_variant(table, self._conditions[environment]["variant"])
        labels = (runs["embodiment"].astype(str) + "/" + runs["student"].astype(str)).to_numpy(object)
        values = pd.Series(runs[PAPERS].to_numpy(float), runs["run_id"].to_numpy(object))
        by_key: dict[tuple[str, ...], dict[str, Sample]] = {}
        seeds = seeds_to_pair(runs)
        pools = runs.groupby([*columns.POOLED, *by], dropna=False, sort=True).ngroup().to_numpy()
        for number, row in table[counted].sort_values("n", kind="stable").to_dict("index").items():
            members = np.flatnonzero(pools == number)
            key = tuple(str(row[column]) for column in ("challenge", "expert_knowledge", *by))
            if row["engine"] == BOX2D and key[-1] == pooling.RELEASED_BIPEDAL:
                key = (*key[:-1], pooling.BIPEDAL)
            sample = _sample(labels[members], values.iloc[members], seeds)
            by_key.setdefault(key, {})[str(row["teacher"])] = sample
        return {key: _with_least(samples) for key, samples in by_key.items()}


def _in_variant(table: pd.DataFrame, chosen: str) -> pd.Series:
    """Return a mask of the rows of a variant, and of bodies whose only variant has the same students.

    Args:
        table: rows from `pooling.pooled`, with or without the column embodiment.
        chosen: the variant.
    """
    mask = table["variant"] == chosen
    if "embodiment" in table:
        students = table["pool"].map(lambda pool: frozenset(name for _, name in pooling.parts_of(pool)))
        alone = table.groupby("embodiment")["variant"].transform("nunique") == 1
        mask |= alone & students.isin(students[mask])
    return mask


def _sample(labels: NDArray[np.object_], values: pd.Series, seeds: Seeds) -> Sample:
    """Return the sample of a pool, from the stratum label (n,) and the value (n,) of each run."""
    measured = values.notna().to_numpy()
    strata = {str(name): values[measured & (labels == name)] for name in sorted(set(labels))}
    weights = stratum_weights([0] * len(strata))
    mean = sum(w * float(stratum.mean()) for w, stratum in zip(weights, strata.values(), strict=True))
    whole = describe(values)
    pairs = {run: seeds[run] for run in values.index[measured] if run in seeds}
    return Sample(Description(whole.n, mean, whole.std), strata, pairs)


def _with_least(samples: Mapping[str, Sample]) -> dict[str, Sample]:
    """Return `samples` (by teacher) with the least variance of each stratum, computed over all teachers."""
    groups: dict[str, list[pd.Series]] = {}
    for sample in samples.values():
        for name, values in sample.strata.items():
            groups.setdefault(name, []).append(values)
    least = {name: least_variance(map(describe, values)) for name, values in groups.items()}
    return {teacher: replace(sample, least=least) for teacher, sample in samples.items()}


def _released_settings(teachers: Collection[str]) -> dict[str, str]:
    """Return the paper's teachers that have runs with the original release's settings only, by full name."""
    names = {join_name(teacher, {"preset": "release"}): teacher for teacher in TEACHERS}
    return {name: own for name, own in names.items() if name in teachers and own not in teachers}


def _settings_notes(released: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Yield sentences about teachers with the settings of the original release, given by environment."""
    for names in dict.fromkeys(tuple(names.items()) for names in released.values() if names):
        where = [title("environment", name) for name, own in released.items() if tuple(own.items()) == names]
        about = f" in {listed(where)}" if len(where) < len(released) else ""
        full, own = (listed(map(label, teachers)) for teachers in zip(*names, strict=True))
        yield f"Without runs of {own}{about}, those of {full} are judged."


def _chosen_conditions(tables: Mapping[str, pd.DataFrame]) -> tuple[dict[str, pd.Series], str]:
    """Return the conditions chosen for each environment, and sentences about conditions not chosen.

    Args:
        tables: results from `pooling.pooled` by environment.
    """
    chosen, sentences = {}, []
    for environment, pools in tables.items():
        complete = pools.assign(complete=pools["missing"] == "")
        complete = complete[complete["steps"].notna()]
        counts = complete.groupby(columns.CONDITIONS, dropna=False)["complete"].sum().reset_index()
        if counts.empty:
            continue
        ordered = counts.sort_values(["complete", "steps"], ascending=False, kind="stable")
        chosen[environment] = ordered.iloc[0][columns.CONDITIONS]
        if len(ordered) == 1:
            continue
        varied = pooling.varying(ordered)
        ordered = ordered.assign(variant=pooling.without_common_phrases(ordered["variant"]))
        used, *others = (
            ", ".join(pooling.condition_words(row, varied)) or USUAL for _, row in ordered.iterrows()
        )
        about = f" about {title('environment', environment)}" if len(tables) > 1 else ""
        apart = " and of ".join(others)
        sentences.append(
            f"Claims{about} are judged by results of {used} alone; apart stand those of {apart}."
        )
    return chosen, " ".join(sentences)


def _other_conditions(table: pd.DataFrame, conditions: pd.Series) -> str:
    """Return the budget and students of results if they are not the paper's, or an empty string."""
    if conditions["engine"] == SIMULATED:
        return "simulated students"
    if conditions["steps"] == PAPER_STEPS and not conditions["variant"]:
        return ""
    rows = table[(table["steps"] == conditions["steps"]) & (table["variant"] == conditions["variant"])]
    students = {student for pool in rows["pool"].unique() for _, student in pooling.parts_of(pool)}
    names = " and ".join(sorted({label(base_name(student)) for student in students}))
    return f"{steps_text(conditions['steps'])} steps of {names}"


def _entries(reading: Reading) -> list[PaperResult]:
    key = (reading.environment, reading.challenge, reading.level)
    return [
        result
        for result in paper_results()
        if (result.environment, result.challenge, result.expert_knowledge) == key
        and (not reading.embodiment or result.embodiments == (reading.embodiment,))
        and not (result.doubt and not is_baseline(result.teacher))
    ]
