"""Ranks of teachers over all challenges: core teachers among themselves, newcomers among the core.

In all functions `runs` are rows from `pooling.pool_runs`, and `measure` is a column of them, in per cent.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.comparisons.aggregates import stratified_means
from analysis.comparisons.pairwise import corrected, from_both_sides, over_challenges
from analysis.data.columns import ACROSS
from analysis.data.reference import core_of, is_baseline
from analysis.formatting import few_seeds_suffix, listed, steps_text
from analysis.measures.tested import AXES, HEADLINE
from analysis.names import label
from analysis.statistics import SIGNIFICANCE
from analysis.statistics.tests import SINGLE_RUN
from tma_ray.support.texts import counted

EQUAL = 1e-9  # teachers whose means differ by less, in points, share a rank

DRAWS = 20_000  # number of draws of true means, to estimate the probability of being best


@dataclass(frozen=True)
class Rank:
    """Rank of a teacher among the core teachers with results on all of its challenges."""

    teacher: str  # name of the teacher
    measure: str  # measure by which teachers are ranked
    newcomer: bool  # True if the teacher joined later; the core is ranked without it
    across: dict[str, Any]  # values of `ACROSS`, which all ranked teachers have in common
    challenges: int  # number of challenges
    mean: float  # mastered test tasks in %, averaged over challenges with equal weights
    low: float  # lower end of the 95 % interval; NaN if a challenge has a single run
    high: float  # upper end of the interval
    n: int  # number of runs
    fewest: int  # minimum number of runs of a ranked teacher in a stratum
    rank: int  # 1 for the highest mean
    of: int  # number of ranked teachers
    better: tuple[str, ...]  # teachers with a lower mean, p < 0.05 after Holm's correction
    worse: tuple[str, ...]  # teachers with a higher mean, p < 0.05 after Holm's correction
    undecided: tuple[str, ...]  # ranked teachers from which it does not differ significantly
    left_out: tuple[str, ...]  # teachers not ranked, for lack of results on some of its challenges
    chance: float  # probability of the highest true mean among teachers with as many challenges, or NaN

    @property
    def best(self) -> int:
        """Best rank that the tests do not rule out."""
        return 1 + len(self.worse)

    @property
    def worst(self) -> int:
        """Worst rank that the tests do not rule out."""
        return self.of - len(self.better)

    def describe(self) -> str:
        """Return a sentence with the rank and the verdicts."""
        variant = f", {self.across['variant']}" if self.across["variant"] else ""
        where = (
            f"expert knowledge {self.across['expert_knowledge']}, {steps_text(self.across['steps'])} steps"
        )
        over = f"Over {counted(self.challenges, 'challenge')} ({where}{variant})"
        if self.of == 1:
            return (
                f"{over} {label(self.teacher)} has no rank: no other teacher has results on the same "
                f"challenges under the same conditions."
            )
        best, worst = self.best, self.worst
        certain = f"and the tests leave {best} to {worst} open" if best < worst else "as the tests confirm"
        parts = (
            ("better than", self.better),
            ("worse than", self.worse),
            ("undecided against", self.undecided),
        )
        verdicts = "; ".join(f"{words} {_listed(names)}" for words, names in parts if names)
        lacking = f"; not ranked, lacking challenges: {_listed(self.left_out)}" if self.left_out else ""
        axis = f" ({AXES[self.measure]})" if self.measure in AXES else ""
        family = "its own tests against them" if self.newcomer else "all pairs of the core"
        standing = f"ranks {self.rank} of {self.of} by mean{axis}, {certain}"
        return (
            f"{over} {label(self.teacher)} {standing}: {verdicts} "
            f"(p < {SIGNIFICANCE} after Holm for {family}{few_seeds_suffix(self.fewest)}){lacking}."
        )


def _listed(names: tuple[str, ...]) -> str:
    return f"{len(names)} ({listed(map(label, names))})"


def ranks(runs: pd.DataFrame, teachers: Collection[str] | None = None, measure: str = HEADLINE) -> list[Rank]:
    """Return the ranks of all teachers, or of `teachers`, by level and budget, best first.

    At each level and budget, teachers of the core are ranked by one family of tests, and each newcomer is
    ranked with the core by a family of its own. A family consists of the pairs of a requested teacher with
    the teachers that have results on all of its challenges.
    """
    ranking: list[Rank] = []
    for key, group in runs[runs[measure].notna()].groupby(ACROSS, dropna=False, sort=True):
        core = core_of(group)
        rows: list[Any] = stratified_means(group, measure).to_dict("records")
        means = {str(row["teacher"]): row for row in rows}
        chances = _chances(means)
        requested = [name for name in means if teachers is None or name in teachers]
        tests = from_both_sides(over_challenges(group, measure, core))
        tests = tests[tests["first"].isin(requested) & tests["second"].isin(core)]
        counts = {name: mean["challenges"] for name, mean in means.items()}
        tests = tests.assign(ranked=tests["challenges"] == tests["first"].map(counts))
        family = tests[tests["ranked"]]
        family = family[~family.index.duplicated()]  # both sides of a pair have the same index
        tests["holm"] = corrected(family, ["family"])["holm"].reindex(tests.index).to_numpy(float)
        by_teacher = dict(list(tests.groupby("first")))
        across = dict(zip(ACROSS, key, strict=True))
        ranked = [
            Rank(
                teacher=name,
                measure=measure,
                newcomer=name not in core,
                across=across,
                chance=chances[name],
                **_standing(means[name], by_teacher.get(name, tests.head(0))),
            )
            for name in requested
        ]
        ranking += sorted(ranked, key=lambda rank: (-rank.mean, rank.teacher))
    return ranking


def _standing(mean: Mapping[str, Any], tests: pd.DataFrame) -> dict[str, Any]:
    """Return the attributes of a `Rank`, from a teacher's mean and its tests against the core."""
    ranked, others = tests["ranked"].to_numpy(bool), tests["second"].to_numpy(object)
    decided = ranked & (tests["holm"].to_numpy(float) < SIGNIFICANCE)
    differences = tests["difference"].to_numpy(float)
    names = {
        "better": others[decided & (differences > 0)],
        "worse": others[decided & ~(differences > 0)],
        "undecided": others[ranked & ~decided],
        "left_out": others[~ranked],
    }
    return {
        "challenges": int(mean["challenges"]),
        "mean": float(mean["difference"]),
        "low": float(mean["low"]),
        "high": float(mean["high"]),
        "n": int(mean["n"]),
        "fewest": int(tests["fewest"].to_numpy()[ranked].min()) if ranked.any() else int(mean["n"]),
        "rank": 1 + int((differences[ranked] < -EQUAL).sum()),
        "of": 1 + int(ranked.sum()),
        **{
            name: tuple(sorted(map(str, teachers), key=lambda teacher: (not is_baseline(teacher), teacher)))
            for name, teachers in names.items()
        },
    }


def _chances(means: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Return each teacher's probability of the highest true mean among those with as many challenges.

    True means are drawn independently from Student's t around the observed means. Probabilities are NaN if
    one of these teachers has a single run in a cell.
    """
    rng = np.random.default_rng(0)
    chances: dict[str, float] = {}
    for challenges in {mean["challenges"] for mean in means.values()}:
        names = [name for name, mean in means.items() if mean["challenges"] == challenges]
        table = pd.DataFrame([means[name] for name in names])
        if (table["reason"] == SINGLE_RUN).any():
            chances |= dict.fromkeys(names, math.nan)
            continue
        errors = (table["difference"] / table["t"]).fillna(0.0).to_numpy(float)  # 0 where no runs vary
        freedom = table["degrees_of_freedom"].fillna(1.0).to_numpy(float)
        drawn = table["difference"].to_numpy(float) + errors * rng.standard_t(freedom, (DRAWS, len(names)))
        best = np.bincount(drawn.argmax(axis=1), minlength=len(names))
        chances |= dict(zip(names, (best / DRAWS).tolist(), strict=True))
    return chances
