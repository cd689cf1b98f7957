"""Pools of runs that form one sample, and the conditions under which results are comparable."""

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
from analysis.data.naming import of_searches
from analysis.data.reference import baseline_runs, core_of
from analysis.formatting import steps_text
from analysis.measures.run_measures import NOT_FINITE, run_measures
from analysis.statistics import describe
from tma_ray.benchmark import MATRICES, Matrix, challenges_of
from tma_ray.results import BOX2D, BOX2D_TEST_SET, CHIPMUNK, SIMULATED
from tma_ray.support.component_names import base_name, join_name, split_name
from tma_ray.support.validation import check_sequence
from tma_ray.tasks import KnowledgeLevel

NOT_BEGUN = "not begun"


def varying(table: pd.DataFrame, columns: Sequence[str] = CONDITIONS) -> list[str]:
    """Return those of `columns` that have more than one value in `table`."""
    return [column for column in columns if table[column].nunique(dropna=False) > 1]


def condition_words(row: pd.Series, columns: Sequence[str] = CONDITIONS) -> list[str]:
    """Return the conditions of a result as phrases, such as ``20 million steps``."""
    phrases = []
    for column in columns:
        value = row[column]
        if column in {"variant", "engine"}:
            phrases += [str(value)] if value else []
        elif pd.isna(value):
            phrases.append(NOT_BEGUN)
        elif column == "steps":
            phrases.append(f"{steps_text(value)} steps")
        elif column == "mastery_threshold":
            phrases.append(f"mastered over {value:g}")
        else:
            phrases.append(f"{column.replace('_', ' ')} {value:g}")
    return list(dict.fromkeys(phrases))


def without_common_phrases(variants: pd.Series) -> pd.Series:
    """Return the variants without the phrases that all of them have."""
    phrases = {text: text.split(BETWEEN_PHRASES) for text in variants.unique()}
    common = set.intersection(*map(set, phrases.values())) if len(phrases) > 1 else set()
    own = {text: [word for word in words if word not in common] for text, words in phrases.items()}
    return variants.map({text: BETWEEN_PHRASES.join(words) for text, words in own.items()})


def by_conditions(runs: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield a tag for file names and the started runs of each set of conditions, largest set first."""
    begun = runs[runs["steps"].notna()]
    columns = varying(begun)
    short = without_common_phrases(begun["variant"])
    groups = [rows for _, rows in begun.groupby(CONDITIONS, dropna=False, sort=True)]
    for rows in sorted(groups, key=lambda rows: -rows["run_id"].nunique()):
        first = pd.Series({**rows.iloc[0], "variant": short[rows.index[0]]})
        words = [
            str(int(first[column])) if column == "steps" else "".join(condition_words(first, [column]))
            for column in columns
        ]
        yield "-".join(re.sub(r"[^0-9A-Za-z]+", "-", word.lower()).strip("-") for word in words if word), rows


PLUS = " + "

BETWEEN_PHRASES = "; "

BIPEDAL, RELEASED_BIPEDAL = "classic_bipedal", "old_classic_bipedal"
"""Embodiment "bipedal" of the paper, and the one of the original release."""


def parts_of(pool: str) -> list[tuple[str, str]]:
    """Return the embodiment and the student of each part of a pool label."""
    return [(body, student) for body, _, student in (part.rpartition("/") for part in pool.split(PLUS))]


def shipped_together(environments: Iterable[str]) -> dict[tuple[str, str, str], tuple[str, ...]]:
    """Return the shipped test sets that are pooled together, by engine, environment and challenge."""
    return {
        (engine, environment, name): tuple(
            sorted(
                f"{prefix}{test_set}"
                for test_set in {challenge.test_set, *challenge.other_test_sets.values()}
            )
        )
        for engine, prefix in ((CHIPMUNK, ""), (BOX2D, BOX2D_TEST_SET))
        for environment in environments
        for name, challenge in challenges_of(environment).items()
    }


@cache
def variant(engine: str, environment: str, challenge: str, pool: str, test_sets: object) -> str:
    """Return a phrase for how a pool differs from the paper's, or an empty string if it does not.

    A variant has one pool per challenge, so aggregates over challenges count each once.
    """
    key = base_name(environment), base_name(challenge)
    settings = split_name(environment)[1] | split_name(challenge)[1]
    parts = parts_of(pool)
    bodies = {BIPEDAL if engine == BOX2D and body == RELEASED_BIPEDAL else body for body, _ in parts}
    students = {student for _, student in parts}
    matrices = [matrix for matrix in MATRICES if (matrix.environment, matrix.challenge) == key]
    words = [f"{name}={value}" for name, value in settings.items()]
    if engine == SIMULATED:
        return BETWEEN_PHRASES.join([*words, "simulated students"])
    if bodies != {body for matrix in matrices for body in matrix.embodiments} and matrices:
        words.append(", ".join(sorted(bodies)))
    if students != ({student for matrix in matrices for student in matrix.students} or {"sac"}):
        words.append(", ".join(sorted(students)))
    shipped = shipped_together([key[0]]).get((engine, *key), ())
    if matrices and isinstance(test_sets, str) and test_sets != PLUS.join(shipped):
        words.append(f"test set {test_sets}")
    return BETWEEN_PHRASES.join(words)


def pool_runs(
    cells: pd.DataFrame, values: pd.DataFrame, matrices: Sequence[Matrix] = MATRICES
) -> pd.DataFrame:
    """Return one row per run of each pool, with its measures.

    Embodiments and students that `matrices` list for a challenge are pooled, except for a few with under half
    as many teachers of the core as another, which form a pool of their own. Another student is pooled over
    the same embodiments, and another embodiment over the same students. The shipped test sets of a challenge,
    one per type of embodiment, count as one, unless an embodiment is tested on several of them. Runs that
    have not begun are counted with those that have, if the latter agree on their settings.

    Args:
        cells: cells of `Frames`.
        values: measures by run_id, as from `run_measures` or `evaluations_at`.
        matrices: matrices of the challenges.

    Returns:
        `POOLED`, `PARTS`, seed, run_id, status, settings (digest of the spec without the seed), core, and the
        columns of `values`, which may have several rows per run. pool and test_sets list their members,
        variant the differences from the paper.
    """
    return _with_values(_pool_members(cells, matrices), values)


def _pool_members(cells: pd.DataFrame, matrices: Sequence[Matrix]) -> pd.DataFrame:
    """Return the rows of `pool_runs` without values: the members of each pool."""
    pools, test_sets = _pools(cells, matrices), _test_sets(cells)
    rows = cells.assign(pool=pools, test_sets=test_sets, settings=cells["settings"].fillna(""))
    rows["core"] = cells.get("core", True)
    for column in SETTINGS:
        values = rows.groupby(["engine", "environment", "challenge", "pool"])[column]
        agreed = values.transform("first").where(values.transform("nunique") == 1)
        rows[column] = rows[column].fillna(agreed)
    names = rows[["engine", "environment", "challenge", "pool", "test_sets"]]
    rows["variant"] = [variant(*key) for key in names.itertuples(index=False, name=None)]
    # several experiments may share a cell
    rows = with_plain_texts(rows).drop_duplicates([*POOLED, "run_id"])
    rows = rows[[*POOLED, *PARTS, "seed", "run_id", "status", "settings", "core"]]
    return rows.sort_values([*POOLED, *PARTS, "seed"], ignore_index=True)


def _with_values(members: pd.DataFrame, values: pd.DataFrame) -> pd.DataFrame:
    """Join the members of pools with the `values` of their runs."""
    values = values[[column for column in values if column not in SETTINGS]]
    return members.merge(values, on="run_id", how="left")


def pooled(
    runs: pd.DataFrame, measures: Sequence[str] = ("mastered_percent",), by: Sequence[str] = ()
) -> pd.DataFrame:
    """Return the results of each teacher: n, mean and standard deviation of each measure over its pool.

    Args:
        runs: rows from `pool_runs`, one per run; a run without the first measure is not counted.
        measures: columns of `runs`.
        by: columns of `PARTS`, for a row per embodiment or student; or step, for learning curves of
            `evaluations_at`.

    Returns:
        `POOLED` and `by`, runs (their number), n (number counted), missing (reasons why the pool is not
        complete; empty if it is), and _n, _mean and _std of each measure, NaN where there are too few runs.
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
        pool = members[group["number"][0]]
        measured = pd.notna(group[measures[0]])
        counted = {name: values[measured] for name, values in group.items()}
        gaps = "; ".join(_gaps(pool, counted, by))
        row = [*(group[key][:1].tolist()[0] for key in keys), len(pool["run_id"]), int(measured.sum()), gaps]
        for sample in (describe(counted[measure]) for measure in measures):
            row += [sample.n, sample.mean, sample.std]
        rows.append(row)
    summaries = [f"{measure}_{name}" for measure in measures for name in ("n", "mean", "std")]
    return pd.DataFrame(rows, columns=[*keys, "runs", "n", "missing", *summaries])


Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""Columns of a table, by name."""


def _split(table: pd.DataFrame, number: str) -> dict[int, Columns]:
    """Return the columns of each group of rows, by group number, as arrays, which are faster than frames."""
    numbers = table[number].to_numpy()
    order = np.argsort(numbers, kind="stable")
    keys, starts = np.unique(numbers[order], return_index=True)
    columns = {str(name): table[name].to_numpy()[order] for name in table}
    return {
        int(key): {name: values[start:end] for name, values in columns.items()}
        for key, (start, end) in zip(keys, itertools.pairwise([*starts, len(order)]), strict=True)
    }


def reuse_random(runs: pd.DataFrame) -> pd.DataFrame:
    """Return `runs` with Random repeated at every level of expert knowledge that other teachers have.

    Missing levels have the runs of `reference.baseline_runs`.
    """
    if runs.empty:
        return runs
    others = [column for column in COMPARED if column != "expert_knowledge"]
    parts = [runs]
    for _, alike in runs.groupby(others, dropna=False):
        for level, group in alike.groupby("expert_knowledge"):
            reused = baseline_runs(group, alike)
            if len(reused) and (reused["expert_knowledge"] != level).all():
                parts.append(reused.assign(expert_knowledge=level))
    return pd.concat(parts, ignore_index=True) if len(parts) > 1 else runs


def levels_together(runs: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Merge the levels of expert knowledge that have the same runs.

    Args:
        runs: rows from `pool_runs`.
        by: columns that runs of a comparison have in common, except the level.
    """
    parts = []
    for _, alike in runs.groupby(list(by), dropna=False, sort=False):
        levels: dict[frozenset[str], list[str]] = {}
        for level in sorted(alike["expert_knowledge"].unique(), key=lambda name: KnowledgeLevel(name).rank):
            run_ids = frozenset(alike.loc[alike["expert_knowledge"] == level, "run_id"])
            levels.setdefault(run_ids, []).append(level)
        for names in levels.values():
            rows = alike[alike["expert_knowledge"] == names[0]]
            parts.append(rows.assign(expert_knowledge=" and ".join(names)))
    return pd.concat(parts).sort_index() if parts else runs


def _label(embodiment: object, student: object) -> str:
    return f"{embodiment}/{student}"


def _pools(cells: pd.DataFrame, matrices: Sequence[Matrix]) -> list[str]:
    """Return the pool label of each cell."""
    bodies: dict[tuple[str, str], set[str]] = {}
    students: dict[tuple[str, str], set[str]] = {}
    for matrix in matrices:
        key = matrix.environment, matrix.challenge
        bodies.setdefault(key, set()).update(matrix.embodiments)
        students.setdefault(key, set()).update(matrix.students)
    pools, rare = [], _rare_parts(cells)
    names = ["engine", "environment", "challenge", *PARTS]
    for engine, environment, challenge, body, student in cells[names].itertuples(index=False, name=None):
        key = environment, challenge
        pooled_students = students[key] if student in students.get(key, ()) else {student}
        pooled_bodies = bodies[key] if body in bodies.get(key, ()) else {body}
        parts = itertools.starmap(_label, itertools.product(pooled_bodies, pooled_students))
        apart = rare.get((engine, *key), frozenset())
        is_rare = _label(body, student) in apart
        pools.append(PLUS.join(sorted(part for part in parts if (part in apart) == is_rare)))
    return pools


LEAST_TEACHERS = 0.5
"""Smallest share of a challenge's teachers for which a body with a student is pooled with the others."""


def _rare_parts(cells: pd.DataFrame) -> dict[tuple[str, str, str], frozenset[str]]:
    """Return the labels of parts with few teachers, by engine, environment and challenge.

    One body that only some teachers have would leave the pools of all others incomplete. Most parts of a
    challenge are never rare, and teachers outside of the core do not count.
    """
    rare = {}
    for key, rows in cells.groupby(["engine", "environment", "challenge"], observed=True):
        engine, environment, challenge = map(str, key)
        core = rows[rows["teacher"].isin(core_of(rows))]
        teachers = core.groupby(PARTS, observed=True)["teacher"].nunique()
        few = teachers[teachers < LEAST_TEACHERS * teachers.max()]
        if 2 * len(few) < len(teachers):
            rare[engine, environment, challenge] = frozenset(itertools.starmap(_label, few.index))
    return rare


def _test_sets(cells: pd.DataFrame) -> pd.Series:
    """Return each cell's test set, replacing a shipped one by all shipped test sets of its challenge.

    This holds for Box2D's and for equally thinned test sets, such as ``parkour_walking:every=2``, too.
    """
    keys = ["engine", "environment", "challenge", "embodiment"]
    single = cells.groupby(keys)["test_set"].transform("nunique") == 1
    shipped = shipped_together(cells["environment"].unique())
    labels = []
    for *key, test_set, alone in zip(*(cells[k] for k in keys[:-1]), cells["test_set"], single, strict=True):
        if alone and isinstance(test_set, str):
            name, settings = split_name(test_set)
            siblings = shipped.get(tuple(key), ())
            if name in siblings:
                test_set = PLUS.join(join_name(sibling, settings) for sibling in siblings)
        labels.append(test_set)
    return pd.Series(labels, index=cells.index, dtype=object)


def _gaps(rows: Columns, counted: Columns, by: Sequence[str]) -> Iterator[str]:
    """Yield the reasons why the rows in `counted` are not the complete pool."""
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
        yield f"evaluated at different steps: {', '.join(f'{value:,.0f}' for value in steps)}"


def _expected(rows: Columns, by: Sequence[str]) -> set[str]:
    """Return the labels of the parts that a complete pool of `rows` would have."""
    labels = set(map(_label, rows["embodiment"], rows["student"]))
    pool = str(rows["pool"][0])
    expected = {pool} if pool in labels else set(pool.split(PLUS))
    for column, end in (("embodiment", "{}/"), ("student", "/{}")):
        if column in by:
            name = end.format(rows[column][0])
            expected = {label for label in expected if f"{label}/".startswith(name) or label.endswith(name)}
    return expected


@computed_once
def runs_after(frames: Frames, share: float = 1.0, *, training: bool = True) -> pd.DataFrame:
    """Return the pooled runs of all results, measured after a share of their budgets; see `result_runs`.

    Args:
        frames: results from `load`.
        share: share of the budget; 1 for the ends of runs.
        training: True for the mean return of training, which needs more files.
    """
    return result_runs(frames, run_measures(frames, share=share, training=training))


def result_runs(frames: Frames, values: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of `pool_runs` for all results, with Random repeated at every level.

    If no runs have the paper's students, those of other students, such as PPO, are the pool.

    Args:
        frames: results from `load`.
        values: measures by run_id, as from `run_measures` or `evaluations_at`.
    """
    return _with_values(_members(frames), values)


@computed_once
def _members(frames: Frames) -> pd.DataFrame:
    """Return the members of all pools, independent of measure and step."""
    groups = by_students(without_searches(frames.cells))
    parts = [_pool_members(chosen, matrices) for _, matrices, chosen in groups]
    members = pd.concat(parts, ignore_index=True).drop_duplicates([*POOLED, "run_id"])
    return reuse_random(members.reset_index(drop=True))


def without_searches(cells: pd.DataFrame) -> pd.DataFrame:
    """Return `cells` without hyper-parameter searches."""
    return cells[~of_searches(cells["experiment"])]


def by_students(cells: pd.DataFrame) -> Iterator[tuple[str, tuple[Matrix, ...], pd.DataFrame]]:
    """Yield a tag for file names, matrices and cells of the paper's students, then of each other student.

    Results of the original release, whose bipedal is a different body, are separate.
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
    for name, matrices, rows in _by_students(cells[imported], released):
        suffix = "" if imported.all() else _file_name(BOX2D)
        yield "-".join(tag for tag in (name, suffix) if tag), matrices, rows


def _by_students(
    cells: pd.DataFrame, matrices: tuple[Matrix, ...]
) -> Iterator[tuple[str, tuple[Matrix, ...], pd.DataFrame]]:
    papers = {(m.environment, m.challenge): m.students for m in MATRICES}
    rows = zip(cells["environment"], cells["challenge"], cells["student"], strict=True)
    other = {
        student
        for environment, challenge, student in rows
        if student not in papers.get((environment, challenge), (student,))
    }
    if not set(cells["student"]) or set(cells["student"]) - other:
        yield "", matrices, cells
    for student in sorted(other):
        alone = tuple(replace(matrix, students=(student,)) for matrix in matrices)
        yield _file_name(student), alone, cells[cells["student"] == student]


def _file_name(text: str) -> str:
    return "".join(character if character.isalnum() else "-" for character in text.lower()).strip("-")
