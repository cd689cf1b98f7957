"""Pools of runs that make up one result, and the conditions that keep results apart."""

import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.data.columns import COMPARED, CONDITIONS, PARTS, POOLED, SETTINGS
from analysis.data.frames import STATUSES, Frames, check_measure, computed_once, with_plain_texts
from analysis.data.identity import of_searches
from analysis.data.reference import baseline_runs
from analysis.formatting import amount
from analysis.measures.run_measures import NOT_FINITE, run_measures
from analysis.statistics import describe
from tma_ray.benchmark import MATRICES, Matrix, challenges_of
from tma_ray.results import BOX2D, BOX2D_TEST_SET, CHIPMUNK, SIMULATED
from tma_ray.support.component_names import base_name, join_name, split_name
from tma_ray.support.validation import check_sequence
from tma_ray.tasks import KnowledgeLevel

NOT_BEGUN = "not begun"


def varying(table: pd.DataFrame, columns: Sequence[str] = CONDITIONS) -> list[str]:
    """Return those of `columns` that have several values in `table`."""
    return [column for column in columns if table[column].nunique(dropna=False) > 1]


def condition_words(row: pd.Series, columns: Sequence[str] = CONDITIONS) -> list[str]:
    """Return the conditions `columns` of a result in words; empty for the paper's own variant."""
    said = []
    for column in columns:
        value = row[column]
        if column in {"variant", "engine"}:
            said += [str(value)] if value else []
        elif pd.isna(value):
            said.append(NOT_BEGUN)
        elif column == "steps":
            said.append(f"{amount(value)} steps")
        elif column == "mastery_threshold":
            said.append(f"mastered over {value:g}")
        else:
            said.append(f"{column.replace('_', ' ')} {value:g}")
    return list(dict.fromkeys(said))


def by_conditions(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the runs under each set of conditions and a tag for file names, the largest set first.

    Runs that have not begun, of no budget yet, belong to none.
    """
    begun = runs[runs["steps"].notna()]
    told = varying(begun)
    groups = [rows for _, rows in begun.groupby(CONDITIONS, dropna=False, sort=True)]
    for rows in sorted(groups, key=lambda rows: -rows["run_id"].nunique()):
        first = rows.iloc[0]
        words = [str(int(first[c])) if c == "steps" else "".join(condition_words(first, [c])) for c in told]
        yield "-".join(re.sub(r"[^0-9A-Za-z]+", "-", word.lower()).strip("-") for word in words if word), rows


PLUS = " + "

BIPEDAL, RELEASED_BIPEDAL = "classic_bipedal", "old_classic_bipedal"
"""The bipedal of the paper, and the body that the original release ran in its place."""


def parts_of(pool: str) -> list[tuple[str, str]]:
    """Return body and student of each part of a pool, as its label names them."""
    return [(body, student) for body, _, student in (part.rpartition("/") for part in pool.split(PLUS))]


def shipped_together(environments: Iterable[str]) -> dict[tuple[str, str, str], tuple[str, ...]]:
    """Return by engine, environment and challenge the test sets that count as one, one per type of body."""
    return {
        (engine, environment, name): tuple(
            sorted(f"{before}{each}" for each in {challenge.test_set, *challenge.other_test_sets.values()})
        )
        for engine, before in ((CHIPMUNK, ""), (BOX2D, BOX2D_TEST_SET))
        for environment in environments
        for name, challenge in challenges_of(environment).items()
    }


@cache
def variant(engine: str, environment: str, challenge: str, pool: str, test_sets: object) -> str:
    """Return the differences of a pool from the paper's, in words; empty where there are none.

    Results of one variant have one pool a challenge, so that aggregates over challenges count each once.
    """
    place = base_name(environment), base_name(challenge)
    settings = split_name(environment)[1] | split_name(challenge)[1]
    parts = parts_of(pool)
    bodies = {BIPEDAL if engine == BOX2D and body == RELEASED_BIPEDAL else body for body, _ in parts}
    students = {student for _, student in parts}
    alike = [matrix for matrix in MATRICES if (matrix.environment, matrix.challenge) == place]
    words = [f"{key}={value}" for key, value in settings.items()]
    if engine == SIMULATED:  # whose body, student and test tasks are all of its own
        return "; ".join([*words, "simulated students"])
    if bodies != {body for matrix in alike for body in matrix.embodiments} and alike:
        words.append(", ".join(sorted(bodies)))
    if students != ({student for matrix in alike for student in matrix.students} or {"sac"}):
        words.append(", ".join(sorted(students)))
    shipped = shipped_together([place[0]]).get((engine, *place), ())
    if alike and isinstance(test_sets, str) and test_sets != PLUS.join(shipped):
        words.append(f"test set {test_sets}")
    return "; ".join(words)


def pool_runs(
    cells: pd.DataFrame, values: pd.DataFrame, matrices: Sequence[Matrix] = MATRICES
) -> pd.DataFrame:
    """Return one row per run of each pool, with its measures.

    What `matrices` list of one challenge is pooled: the three bodies of Parkour, the two bodies by two
    students of diverse students. A student that takes the place of theirs is pooled over the same bodies,
    and any other body over the same students, as a pool of its own.
    The shipped test sets of a challenge, one for each type of body, count as one; a body tested on
    several of them is not pooled. Runs that have not begun are counted with those that have, if these
    agree on their settings.

    Args:
        cells: cells of `Frames`.
        values: measures by run_id, as from `run_measures` or `evaluations_at`.
        matrices: bodies and students that belong together, by challenge.

    Returns:
        `POOLED`, `PARTS`, seed, run_id, status, settings (digest of the spec without the seed), core (of
        `Frames`), and the columns of `values`; several rows a run if these have. pool and test_sets name all
        that belong to them, variant says how these differ from the paper's.
    """
    return _with_values(_pool_members(cells, matrices), values)


def _pool_members(cells: pd.DataFrame, matrices: Sequence[Matrix]) -> pd.DataFrame:
    """Return the rows of `pool_runs` without values: the members of each pool."""
    pools, test_sets = _pools(cells, matrices), _test_sets(cells)
    rows = cells.assign(pool=pools, test_sets=test_sets, settings=cells["settings"].fillna(""))
    rows["core"] = cells.get("core", True)
    for column in SETTINGS:
        known = rows.groupby(["engine", "environment", "challenge", "pool"])[column]
        agreed = known.transform("first").where(known.transform("nunique") == 1)
        rows[column] = rows[column].fillna(agreed)
    names = rows[["engine", "environment", "challenge", "pool", "test_sets"]]
    rows["variant"] = [variant(*key) for key in names.itertuples(index=False, name=None)]
    # Experiments may list the same cell: its runs count once.
    rows = with_plain_texts(rows).drop_duplicates([*POOLED, "run_id"])
    rows = rows[[*POOLED, *PARTS, "seed", "run_id", "status", "settings", "core"]]
    return rows.sort_values([*POOLED, *PARTS, "seed"], ignore_index=True)


def _with_values(members: pd.DataFrame, values: pd.DataFrame) -> pd.DataFrame:
    """Return `members` of pools with the `values` of each run."""
    values = values[[column for column in values if column not in SETTINGS]]
    return members.merge(values, on="run_id", how="left")


def pooled(
    runs: pd.DataFrame, measures: Sequence[str] = ("mastered_percent",), by: Sequence[str] = ()
) -> pd.DataFrame:
    """Return the result of each teacher: n, mean and standard deviation of measures over its pool.

    Args:
        runs: rows of `pool_runs`, one per run. A run without the first measure is not counted.
        measures: columns of `runs`.
        by: columns of `PARTS`, to have a row for each body or student instead; or step, with values of
            `evaluations_at`, for learning curves over the runs that got to each step.

    Returns:
        `POOLED` and `by`, runs (how many belong to it), n (how many are counted), missing (why this is
        not the whole pool, in words; empty if it is), and for each measure its _n, _mean, _std: NaN where
        there are too few runs.
    """
    check_sequence("measures", measures)
    if not measures:
        raise ValueError("measures is empty: expected columns of the runs, such as mastered_percent")
    check_sequence("by", by)
    keys, rows = [*POOLED, *by], []
    for measure in measures:
        check_measure("runs", runs, measure, keys)
    whole = runs.groupby([column for column in keys if column != "step"], dropna=False).ngroup()
    runs = runs.assign(number=whole)
    members = _split(runs.drop_duplicates(["number", "run_id"]), "number")
    runs = runs[runs["step"].notna()] if "step" in by else runs
    runs = runs.assign(group=runs.groupby(keys, dropna=False, sort=True).ngroup())
    for group in _split(runs, "group").values():
        listed = members[group["number"][0]]
        there = pd.notna(group[measures[0]])
        counted = {name: values[there] for name, values in group.items()}
        gaps = "; ".join(_gaps(listed, counted, by))
        row = [*(group[key][:1].tolist()[0] for key in keys), len(listed["run_id"]), int(there.sum()), gaps]
        for described in (describe(counted[measure]) for measure in measures):
            row += [described.n, described.mean, described.std]
        rows.append(row)
    summaries = [f"{measure}_{name}" for measure in measures for name in ("n", "mean", "std")]
    return pd.DataFrame(rows, columns=[*keys, "runs", "n", "missing", *summaries])


Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""Columns of rows, by name."""


def _split(table: pd.DataFrame, number: str) -> dict[int, Columns]:
    """Return the rows of each `number`, in rising order, as arrays: thousands of frames take seconds."""
    numbers = table[number].to_numpy()
    order = np.argsort(numbers, kind="stable")
    found, ends = np.unique(numbers[order], return_index=True)
    columns = {str(name): table[name].to_numpy()[order] for name in table}
    places = np.split(np.arange(len(order)), ends[1:]) if len(order) else []
    return {
        int(each): {name: values[place] for name, values in columns.items()}
        for each, place in zip(found, places, strict=True)
    }


def reuse_random(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with Random at every level of expert knowledge at which another teacher was run.

    The rule of `reference.baseline_runs` chooses the runs for levels at which it was not run.
    """
    if runs.empty:
        return runs
    others = [column for column in COMPARED if column != "expert_knowledge"]
    parts = [runs]
    for _, alike in runs.groupby(others, dropna=False):
        for level, group in alike.groupby("expert_knowledge"):
            found = baseline_runs(group, alike)
            if len(found) and (found["expert_knowledge"] != level).all():
                parts.append(found.assign(expert_knowledge=level))
    return pd.concat(parts, ignore_index=True) if len(parts) > 1 else runs


def levels_together(runs: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Return `runs` with the levels of expert knowledge at which the same runs count as one: none and low.

    Teachers that do not tell two levels apart have the same runs at both.

    Args:
        runs: rows of `pool_runs`.
        by: columns that runs of a comparison have in common, without the level.
    """
    parts = []
    for _, alike in runs.groupby(list(by), dropna=False, sort=False):
        levels: dict[frozenset[str], list[str]] = {}
        for level in sorted(alike["expert_knowledge"].unique(), key=lambda name: KnowledgeLevel(name).rank):
            run_ids = frozenset(alike.loc[alike["expert_knowledge"] == level, "run_id"])
            levels.setdefault(run_ids, []).append(level)
        for names in levels.values():
            one = alike[alike["expert_knowledge"] == names[0]]
            parts.append(one.assign(expert_knowledge=" and ".join(names)))
    return pd.concat(parts).sort_index() if parts else runs


def _label(embodiment: object, student: object) -> str:
    return f"{embodiment}/{student}"


def _pools(cells: pd.DataFrame, matrices: Sequence[Matrix]) -> list[str]:
    """Return for each cell the labels of all parts of its pool."""
    bodies: dict[tuple[str, str], set[str]] = {}
    students: dict[tuple[str, str], set[str]] = {}
    for matrix in matrices:
        place = matrix.environment, matrix.challenge
        bodies.setdefault(place, set()).update(matrix.embodiments)
        students.setdefault(place, set()).update(matrix.students)
    found = []
    names = ["environment", "challenge", *PARTS]
    for environment, challenge, body, student in cells[names].itertuples(index=False, name=None):
        place = environment, challenge
        together = students[place] if student in students.get(place, ()) else {student}
        own = bodies[place] if body in bodies.get(place, ()) else {body}
        found.append(PLUS.join(sorted(_label(*part) for part in itertools.product(own, together))))
    return found


def _test_sets(cells: pd.DataFrame) -> pd.Series:
    """Return for each cell its test set, or all shipped ones of its challenge if that is one of them.

    Those of Box2D's worlds have names of their own, and belong together as ours do. Where all are thinned
    alike, as ``parkour_walking:every=2``, they do so too.
    """
    place = ["engine", "environment", "challenge", "embodiment"]
    alone = cells.groupby(place)["test_set"].transform("nunique") == 1
    shipped = shipped_together(cells["environment"].unique())
    places = cells[place[:-1]].itertuples(index=False, name=None)
    together = [
        _with_its_siblings(test_set, shipped.get(where, ()))
        if single and isinstance(test_set, str)
        else test_set
        for where, test_set, single in zip(places, cells["test_set"], alone, strict=True)
    ]
    return pd.Series(together, index=cells.index, dtype=object)


def _with_its_siblings(test_set: str, shipped: Sequence[str]) -> str:
    name, settings = split_name(test_set)
    return PLUS.join(join_name(each, settings) for each in shipped) if name in shipped else test_set


def _gaps(rows: Columns, counted: Columns, by: Sequence[str]) -> Iterator[str]:
    """Yield the reasons why the `counted` rows are not a complete pool."""
    ids = set(counted["run_id"])
    reasons = rows["reason"] if "reason" in rows else rows["status"]
    uncounted = Counter(
        NOT_FINITE if reason == NOT_FINITE else status
        for run_id, status, reason in zip(rows["run_id"], rows["status"], reasons, strict=True)
        if run_id not in ids
    )
    if uncounted:
        words = (*STATUSES, NOT_FINITE)
        numbers = (f"{uncounted[word]} {word}" for word in words if uncounted[word])
        yield f"not counted: {', '.join(numbers)}"
    labels = list(map(_label, counted["embodiment"], counted["student"]))
    sizes = Counter(labels)
    absent = sorted(_expected(rows, by) - set(sizes))
    if absent:
        yield f"no results of {', '.join(absent)}"
    if len(set(sizes.values())) > 1:
        yield f"unequal numbers of seeds: {', '.join(f'{label} {sizes[label]}' for label in sorted(sizes))}"
    settings = Counter(label for label, _ in set(zip(labels, counted["settings"], strict=True)))
    if max(settings.values(), default=0) > 1:
        yield f"different settings: {', '.join(sorted(label for label, n in settings.items() if n > 1))}"
    seeds = Counter(zip(labels, counted["seed"], strict=True))
    if max(seeds.values(), default=0) > 1:
        twice = sorted({label for (label, _), n in seeds.items() if n > 1})
        yield f"seeds counted more than once: {', '.join(twice)}"
    step = "evaluated_at" if "evaluated_at" in counted else "step"
    steps = sorted(set(counted[step])) if step in counted else []
    if len(steps) > 1:
        yield f"evaluated at different steps: {', '.join(f'{each:,.0f}' for each in steps)}"


def _expected(rows: Columns, by: Sequence[str]) -> set[str]:
    """Return the labels of the parts that the pool of these rows should have."""
    here = set(map(_label, rows["embodiment"], rows["student"]))
    pool = str(rows["pool"][0])
    expected = {pool} if pool in here else set(pool.split(PLUS))
    for column, end in (("embodiment", "{}/"), ("student", "/{}")):
        if column in by:
            name = end.format(rows[column][0])
            expected = {label for label in expected if f"{label}/".startswith(name) or label.endswith(name)}
    return expected


@computed_once
def runs_after(frames: Frames, share: float = 1.0, *, training: bool = True) -> pd.DataFrame:
    """Return `result_runs` after a share of the budget of each run; 1 for the ends of runs.

    With `training` they have the mean return of training, for which more files are read.
    """
    return result_runs(frames, run_measures(frames, share=share, training=training))


def result_runs(frames: Frames, values: pd.DataFrame) -> pd.DataFrame:
    """Return all runs that count as results, in the pools they belong to, with Random at every level.

    Where only students run that the paper does not have there, such as PPO everywhere, these are the pool.
    One rule for all readers.

    Args:
        frames: results of `load`.
        values: measures by run_id, as from `run_measures` or `evaluations_at`.

    Returns:
        Of `pooling.pool_runs`.
    """
    return _with_values(_members(frames), values)


@computed_once
def _members(frames: Frames) -> pd.DataFrame:
    """Return the runs of all pools, independent of measure and step."""
    groups = by_students(without_searches(frames.cells))
    parts = [_pool_members(chosen, matrices) for _, matrices, chosen in groups]
    members = pd.concat(parts, ignore_index=True).drop_duplicates([*POOLED, "run_id"])
    return reuse_random(members.reset_index(drop=True))


def without_searches(cells: pd.DataFrame) -> pd.DataFrame:
    """Return `cells` without points of searches for hyper-parameters."""
    return cells[~of_searches(cells["experiment"])]


def by_students(cells: pd.DataFrame) -> Iterator[tuple[str, tuple[Matrix, ...], pd.DataFrame]]:
    """Yield the paper's students together, then each other one alone, with the matrices to pool by.

    Each with a tag for names of files. Results of the original release, whose bipedal is another one, stand
    apart from others in the same root.
    """
    imported = (cells["engine"] == BOX2D).to_numpy(bool)
    if not (imported & (cells["embodiment"] == RELEASED_BIPEDAL).to_numpy(bool)).any():
        yield from _by_students(cells, MATRICES)
        return
    if not imported.all():
        yield from _by_students(cells[~imported], MATRICES)
    released = tuple(
        replace(m, embodiments=tuple(RELEASED_BIPEDAL if body == BIPEDAL else body for body in m.embodiments))
        for m in MATRICES
    )
    for name, matrices, chosen in _by_students(cells[imported], released):
        apart = "" if imported.all() else _file_name(BOX2D)
        yield "-".join(tag for tag in (name, apart) if tag), matrices, chosen


def _by_students(
    cells: pd.DataFrame, matrices: tuple[Matrix, ...]
) -> Iterator[tuple[str, tuple[Matrix, ...], pd.DataFrame]]:
    theirs = {(m.environment, m.challenge): m.students for m in MATRICES}
    places = zip(cells["environment"], cells["challenge"], cells["student"], strict=True)
    other = {
        student for *place, student in places if student not in theirs.get((place[0], place[1]), (student,))
    }
    if not set(cells["student"]) or set(cells["student"]) - other:
        yield "", matrices, cells
    for student in sorted(other):
        alone = tuple(replace(matrix, students=(student,)) for matrix in matrices)
        yield _file_name(student), alone, cells[cells["student"] == student]


def _file_name(text: str) -> str:
    return "".join(character if character.isalnum() else "-" for character in text.lower()).strip("-")
