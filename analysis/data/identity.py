"""The identity of results: runs that differ in anything that identifies them have different names.

Every view groups runs by the names of their environment, challenge, body, student, teacher and test set. A
name that means different things among some runs (another version of an algorithm, another content of a
file, other hyper-parameters under the same label) would pool what must not be pooled. So each such name is
split here, once, when results are read: most runs keep the plain name, the others get one that says what
differs.
"""

import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import pandas as pd

from analysis.data.columns import COMPARISON, FROM_SPEC, NAME_SCOPE, NAMED, RUN_CONDITIONS
from tma_ray.benchmark import EXPERIMENTS, Matrix
from tma_ray.results import CHIPMUNK
from tma_ray.support.component_names import join_name, split_name
from tma_ray.support.decoding import DamagedFileError, decode_json
from tma_ray.tasks import MASTERY_RETURN

OF_BODIES = ("embodiment", "original_embodiment")
"""Options of environments that name the body, as its own column does; the second of imported runs."""

MOST_SETTINGS = 4
"""Settings that a name lists; more are told by their hash."""

BEFORE_VERSIONS = "before 1"
"""Version of an algorithm whose runs were made before there were versions."""


def identity(spec: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the identity of each part of a run, by the column of `NAMED` that names it.

    `spec` has JSON values; it is empty for a run without one.
    """
    options = {
        key: value for key, value in spec.get("environment_options", {}).items() if key not in OF_BODIES
    }
    files = {name: file["sha256"][:8] for name, file in spec.get("inputs", {}).items()}
    body = files.pop("environment.embodiment", None)
    steps = spec.get("schedule", {}).get("steps") or 1
    space = {each["name"]: f"{each['low']:g}..{each['high']:g}" for each in spec.get("task_space", ())}
    challenge = {
        "easy_task": spec.get("easy_task"),
        "cuts": spec.get("cuts", 0),
        "resets": [round(step / steps, 3) for step in spec.get("resets", ())],  # shares of the budget
    }
    return {
        "environment": {**options, **_of_part(spec, "environment", files)},
        "challenge": space | challenge,
        "embodiment": {"sha256": body} if body else {},
        "student": {**spec.get("student_hyperparameters", {}), **_of_part(spec, "student", files)},
        "teacher": {**spec.get("teacher_hyperparameters", {}), **_of_part(spec, "teacher", files)},
        "test_set": {"sha256": _digest(spec["test_set"])} if "test_set" in spec else {},
    }


def disambiguate_names(cells: Sequence[pd.DataFrame]) -> tuple[list[pd.DataFrame], tuple[str, ...]]:
    """Return the cells of one or several roots with unambiguous names, and the names that were split.

    Points of searches for hyper-parameters, which differ by design, keep their names.

    Args:
        cells: cells of `Frames`, with the column identity (JSON of `identity`, null for runs that
            wait). Names that were split before are first united, so that roots can be named jointly.

    Returns:
        The same rows with other names, and a sentence for each new name.
    """
    frames = [_with_plain_names(frame) for frame in cells]
    identified = [each["identity"].notna() & ~of_searches(each["experiment"]) for each in frames]
    known = pd.concat(
        [frame[apart] for frame, apart in zip(frames, identified, strict=True)], ignore_index=True
    )
    known = known.drop_duplicates("run_id")
    said: list[str] = []
    for column in NAMED:
        variants = _variants(known, column)
        names = _names(variants)
        if not names:
            continue
        for frame, apart in zip(frames, identified, strict=True):
            rows = zip(_variants(frame, column), frame[column], apart, strict=True)
            frame[column] = [names.get(variant, name) if mine else name for variant, name, mine in rows]
        renamed = known.assign(to=[names.get(variant, "") for variant in variants])
        for (name, to), runs in renamed[renamed["to"] != ""].groupby([column, "to"]):
            said.append(f"{_runs(len(runs))} of {column} {name!r} stand apart as {to!r}.")
    return frames, tuple(said)


def split_experiments(cells: pd.DataFrame) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Return cells in which each experiment has runs of one budget, physics, threshold and test set.

    The runs of a place that differ from most get another name of their experiment, which says how; a sentence
    for each new name is returned, too.
    """
    begun = cells[cells["steps"].notna()]
    names, said = cells["experiment"].copy(), []
    for key, rows in begun.groupby(COMPARISON, sort=True):
        variants = Counter(rows[list(RUN_CONDITIONS)].itertuples(index=False, name=None))
        if len(variants) < 2:
            continue
        most = max(variants, key=lambda values: (variants[values], str(values)))
        for values in sorted(set(variants) - {most}, key=str):
            pairs = zip(RUN_CONDITIONS.values(), values, most, strict=True)
            words = ", ".join(text.format(value) for text, value, other in pairs if value != other)
            mine = (rows[list(RUN_CONDITIONS)] == list(values)).all(axis=1)
            names[mine.index[mine]] = f"{key[1]} ({words})"
            where = f"{key[2]} {key[3]}, {key[5]}"
            said.append(f"{_runs(int(mine.sum()))} of {key[1]} ({where}) stand apart: {words}.")
    return cells.assign(experiment=names), tuple(said)


def searches() -> list[Matrix]:
    """Return the matrices that search for hyper-parameters."""
    matrices = (matrix for experiment in EXPERIMENTS for matrix in experiment.matrices)
    return [matrix for matrix in matrices if matrix.teacher_grid or matrix.student_grid]


def of_searches(experiments: pd.Series) -> pd.Series:
    """Return a mask of the `experiments` whose names are those of points of a search."""
    names = "|".join(matrix.name for matrix in searches())
    search = re.compile(rf"({names})(_\d+)?( \(.*\))?")
    found = {name: search.fullmatch(name) is not None for name in experiments.unique()}
    return experiments.map(found).astype(bool)


def _of_part(spec: Mapping[str, Any], part: str, files: Mapping[str, str]) -> dict[str, Any]:
    """Return version, source and files of a part; nothing if the run's spec lacks them."""
    if not spec or part not in spec:
        return {}
    found: dict[str, Any] = {"algorithm_version": spec.get("algorithm_versions", {}).get(part)}
    plugin = spec.get("plugins", {}).get(part)
    if plugin is not None:
        found["source"] = plugin["digest"][:8]
    elif found["algorithm_version"] is None:
        found["algorithm_version"] = BEFORE_VERSIONS
    return found | {
        name.removeprefix(f"{part}."): sha256 for name, sha256 in files.items() if name.startswith(f"{part}.")
    }


def _with_plain_names(cells: pd.DataFrame) -> pd.DataFrame:
    if "names" not in cells:
        names = [json.dumps(row) for row in cells[NAMED].to_dict("records")]
        return cells.assign(names=pd.Series(names, index=cells.index, dtype=object))
    return cells.assign(**{name: [json.loads(text)[name] for text in cells["names"]] for name in NAMED})


def _variants(cells: pd.DataFrame, column: str) -> list[tuple[Any, ...]]:
    """Return the scope of the name of each row, the name, and the settings that it means."""
    places = [*NAME_SCOPE, "environment"] if column == "challenge" else NAME_SCOPE
    codes, texts = pd.factorize(cells["identity"], use_na_sentinel=False)  # long, and few
    settings = [_settings(text, column) for text in texts]
    columns = [cells[name].to_numpy(object) for name in (*places, column)]
    return [(*key, settings[code]) for *key, code in zip(*columns, codes, strict=True)]


def _names(of_runs: Sequence[tuple[Any, ...]]) -> dict[tuple[Any, ...], str]:
    """Return the new name of each variant but that of most runs, by `NAME_SCOPE`, old name and settings."""
    variants: dict[tuple[Any, ...], Counter[str]] = {}
    for *key, settings in of_runs:
        variants.setdefault(tuple(key), Counter())[settings] += 1
    found = {}
    for scope, counts in variants.items():
        plain = max(counts, key=lambda settings: (counts[settings], settings))
        reference, (base, own) = json.loads(plain), split_name(str(scope[-1]))
        for settings in set(counts) - {plain}:
            values = json.loads(settings)
            names = {**reference, **values}
            differing = {n: values.get(n) for n in names if values.get(n) != reference.get(n)}
            if len(differing) > MOST_SETTINGS:
                version = {key: value for key, value in differing.items() if key == "algorithm_version"}
                differing = version | {"settings": _digest(values)}
            found[(*scope, settings)] = join_name(base, {**own, **differing})
    return found


@cache
def _settings(text: object, column: str) -> str:
    """Return the settings of one column of an identity, as JSON with sorted keys."""
    if not isinstance(text, str):
        return "{}"
    return json.dumps(json.loads(text)[column], sort_keys=True)


def _runs(count: int) -> str:
    return f"{count} run{'s' if count > 1 else ''}"


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:8]


SEED = re.compile(r'"seed": \d+, "student":')
"""The seed in a spec, whose keys are sorted, with the key that follows it."""


def parsed(text: object) -> dict[str, Any]:
    """Return the JSON object in `text`, or an empty one if it holds something else."""
    try:
        return decode_json(text, dict[str, Any], "a spec") if isinstance(text, str) else {}
    except DamagedFileError:
        return {}


def mastery_threshold(spec: object) -> float:
    """Return the episodic return over which tasks are mastered in a run with this `spec` (JSON)."""
    return float(parsed(spec).get("mastery_threshold", MASTERY_RETURN))


def with_settings(runs: pd.DataFrame) -> pd.DataFrame:
    """Add what comparisons need of each run's spec: engine, mastery_threshold, settings and identity.

    A spec is long, and there are thousands: those that differ in their seed alone are parsed once.
    """
    texts = []
    for text in runs["spec"]:
        seedless, found = SEED.subn('"student":', text, count=1)
        if not found:
            seedless = json.dumps({name: value for name, value in parsed(text).items() if name != "seed"})
        texts.append(seedless)
    known = {}
    for text in set(texts):
        spec = parsed(text)
        threshold = float(spec.get("mastery_threshold", MASTERY_RETURN))
        digest = hashlib.sha256(text.encode()).hexdigest()[:12]
        identities = json.dumps(identity(spec), sort_keys=True)
        known[text] = str(spec.get("engine", CHIPMUNK)), threshold, digest, identities
    return runs.assign(**{name: [known[text][i] for text in texts] for i, name in enumerate(FROM_SPEC)})


def thresholds_of(evaluations: pd.DataFrame, runs: pd.DataFrame) -> pd.Series | float:
    """Return the threshold of each evaluation's run; one number where all have the same."""
    known = runs["mastery_threshold"].unique()
    if len(known) == 1:
        return float(known[0])
    return evaluations["run_id"].map(runs.set_index("run_id")["mastery_threshold"]).astype(float)
