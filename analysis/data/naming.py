"""Disambiguation of names that stand for several settings or versions.

Views group runs by the names of their environment, challenge, body, student, teacher and test set. A name
with several meanings among some runs (versions of an algorithm, contents of a file, hyper-parameters under
one label) would pool runs that must stay apart. Each such name is split once, when results are read: most
runs keep the plain name, the others get one that includes the difference.
"""

import json
import re
from collections import Counter
from collections.abc import Sequence
from functools import cache
from typing import Any

import pandas as pd

from analysis.data.columns import COMPARISON, NAME_SCOPE, NAMED, RUN_CONDITIONS
from analysis.data.specs import digest_of
from tma_ray.benchmark import EXPERIMENTS, Matrix
from tma_ray.support.component_names import join_name, split_name
from tma_ray.support.texts import counted

MOST_SETTINGS = 4  # a name with more settings contains their hash instead


def disambiguate_names(cells: Sequence[pd.DataFrame]) -> tuple[list[pd.DataFrame], tuple[str, ...]]:
    """Return the cells of one or several roots with unambiguous names, and a sentence about each new name.

    Points of searches for hyper-parameters, which differ by design, keep their names.

    Args:
        cells: cells of `Frames`, with the column identity, which is null for waiting runs. Earlier splits
            are undone first, so that roots can be named jointly.
    """
    frames = [_with_plain_names(frame) for frame in cells]
    identified = [frame["identity"].notna() & ~of_searches(frame["experiment"]) for frame in frames]
    rows_of_runs = pd.concat(
        [frame[mask] for frame, mask in zip(frames, identified, strict=True)], ignore_index=True
    )
    runs = rows_of_runs.drop_duplicates("run_id")
    sentences: list[str] = []
    for column in NAMED:
        variants = _variants(runs, column)
        names = _names(variants)
        if not names:
            continue
        for frame, mask in zip(frames, identified, strict=True):
            rows = zip(_variants(frame, column), frame[column], mask, strict=True)
            frame[column] = [names.get(variant, name) if split else name for variant, name, split in rows]
        renamed = runs.assign(to=[names.get(variant, "") for variant in variants])
        for (name, to), group in renamed[renamed["to"] != ""].groupby([column, "to"]):
            sentences.append(f"{counted(len(group), 'run')} of {column} {name!r} stand apart as {to!r}.")
    return frames, tuple(sentences)


def split_experiments(cells: pd.DataFrame) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Split experiments whose runs differ in `RUN_CONDITIONS`; return cells and a sentence per new name.

    In each comparison, runs that differ from most others get an experiment named after the difference.
    """
    begun = cells[cells["steps"].notna()]
    names, sentences = cells["experiment"].copy(), []
    for key, rows in begun.groupby(COMPARISON, sort=True):
        variants = Counter(rows[list(RUN_CONDITIONS)].itertuples(index=False, name=None))
        if len(variants) < 2:
            continue
        most = max(variants, key=lambda values: (variants[values], str(values)))
        for values in sorted(set(variants) - {most}, key=str):
            pairs = zip(RUN_CONDITIONS.values(), values, most, strict=True)
            words = ", ".join(text.format(value) for text, value, other in pairs if value != other)
            differs = (rows[list(RUN_CONDITIONS)] == list(values)).all(axis=1)
            names[differs.index[differs]] = f"{key[1]} ({words})"
            where = f"{key[2]} {key[3]}, {key[5]}"
            runs = counted(int(differs.sum()), "run")
            sentences.append(f"{runs} of {key[1]} ({where}) stand apart: {words}.")
    return cells.assign(experiment=names), tuple(sentences)


def searches() -> list[Matrix]:
    """Return the matrices that are hyper-parameter searches."""
    matrices = (matrix for experiment in EXPERIMENTS for matrix in experiment.matrices)
    return [matrix for matrix in matrices if matrix.teacher_grid or matrix.student_grid]


def of_searches(experiments: pd.Series) -> pd.Series:
    """Return a mask of the `experiments` that are points of a hyper-parameter search."""
    names = "|".join(matrix.name for matrix in searches())
    search = re.compile(rf"({names})(_\d+)?( \(.*\))?")
    matches = {name: search.fullmatch(name) is not None for name in experiments.unique()}
    return experiments.map(matches).astype(bool)


def _with_plain_names(cells: pd.DataFrame) -> pd.DataFrame:
    if "names" not in cells:
        names = [json.dumps(row) for row in cells[NAMED].to_dict("records")]
        return cells.assign(names=pd.Series(names, index=cells.index, dtype=object))
    return cells.assign(**{name: [json.loads(text)[name] for text in cells["names"]] for name in NAMED})


def _variants(cells: pd.DataFrame, column: str) -> list[tuple[Any, ...]]:
    """Return the values that distinguish the components in `column`, one tuple per row of `cells`."""
    scope = [*NAME_SCOPE, "environment"] if column == "challenge" else NAME_SCOPE
    codes, texts = pd.factorize(cells["identity"], use_na_sentinel=False)
    settings = [_settings(text, column) for text in texts]
    columns = [cells[name].to_numpy(object) for name in (*scope, column)]
    return [(*key, settings[code]) for *key, code in zip(*columns, codes, strict=True)]


def _names(of_runs: Sequence[tuple[Any, ...]]) -> dict[tuple[Any, ...], str]:
    """Return new names of variants, leaving the plain name to the most frequent variant in each scope."""
    variants: dict[tuple[Any, ...], Counter[str]] = {}
    for *key, settings in of_runs:
        variants.setdefault(tuple(key), Counter())[settings] += 1
    names = {}
    for scope, counts in variants.items():
        plain = max(counts, key=lambda settings: (counts[settings], settings))
        reference, (base, named) = json.loads(plain), split_name(str(scope[-1]))
        for settings in set(counts) - {plain}:
            values = json.loads(settings)
            keys = {**reference, **values}
            differing = {key: values.get(key) for key in keys if values.get(key) != reference.get(key)}
            if len(differing) > MOST_SETTINGS:
                version = {key: value for key, value in differing.items() if key == "algorithm_version"}
                differing = version | {"settings": digest_of(values)}
            names[(*scope, settings)] = join_name(base, {**named, **differing})
    return names


@cache
def _settings(text: object, column: str) -> str:
    """Return the settings of one component from a run's identity, as JSON with sorted keys."""
    if not isinstance(text, str):
        return "{}"
    return json.dumps(json.loads(text)[column], sort_keys=True)
