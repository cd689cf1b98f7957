"""Repetitions: a release for other teachers, and unfinished runs of a results root."""

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tma_ray.campaign.options import SCHEDULE, CampaignOptions
from tma_ray.campaign.plan import Plan, cell_row
from tma_ray.campaign.script import SINGLE_RUNS, run_plan
from tma_ray.results import SIMULATED, Inspector, Results, RunStatus, Table
from tma_ray.runs import Cell, RunSpec, effective_spec
from tma_ray.runs.inputs import fetch, import_plugins
from tma_ray.support.decoding import DamagedFileError
from tma_ray.support.texts import counted
from tma_ray.tasks import KnowledgeLevel

TEACHER_FIELDS = ("teacher", "teacher_hyperparameters", "expert_knowledge", "seed", "repeat")
"""Fields of a spec in which another teacher may differ."""

BY_PART = ("plugins", "algorithm_versions", "inputs")  # fields of a spec with an entry for each of its parts


@dataclass(frozen=True)
class _Setting:
    """Cells of a release that differ in teachers and seeds only: the spec of one, and the seeds of all."""

    experiment: str
    level: KnowledgeLevel
    template: RunSpec
    seeds: tuple[int, ...]


def like_plan(
    name: str,
    released: Results,
    teachers: Sequence[str],
    core: Collection[str] = (),
    challenges: Collection[str] = (),
    seeds: Collection[int] = (),
) -> Plan:
    """Return the runs of `teachers` on the cells of a release, with its seeds and settings.

    Every cell's first seed comes before any cell's second.

    Args:
        name: name of the campaign.
        released: release to repeat.
        teachers: names in the teacher registry, or ``module:Name``.
        core: campaigns of the release to repeat; all by default.
        challenges: challenges of the release to repeat; all by default.
        seeds: seeds of the release to repeat; all by default.

    Raises:
        ValueError: a challenge, seed or campaign that the release does not have, a teacher that cannot run,
            or a release that this version cannot repeat.
    """
    settings = _settings(released, core)
    _check_there("challenge", challenges, dict.fromkeys(each.template.challenge for each in settings))
    settings = [each for each in settings if not challenges or each.template.challenge in challenges]
    _check_there("seed", seeds, sorted({seed for setting in settings for seed in setting.seeds}))
    if seeds:
        settings = [replace(each, seeds=tuple(s for s in each.seeds if s in seeds)) for each in settings]
        settings = [each for each in settings if each.seeds]
    planned = [
        (place, spec, row)
        for setting in settings
        for teacher in teachers
        for place, (spec, row) in enumerate(_runs(setting, teacher, released))
    ]
    rows = tuple(row for _, _, row in planned)
    runs = {spec.run_id: spec for _, spec, _ in sorted(planned, key=lambda each: each[0])}
    cells = counted(len(settings) * len(teachers), "cell")
    size = f"{cells} like those of {released.store}, {len(rows):,} with their seeds"
    return Plan(name, size, tuple(runs.values()), rows)


def _check_there(kind: str, chosen: Collection[Any], there: Collection[Any]) -> None:
    for each in chosen:
        if each not in there:
            raise ValueError(f"the release has no {kind} {each!r}; it has {', '.join(map(str, there))}")


def trial_plan(
    name: str, released: Results, teacher: str, places: Sequence[tuple[str, ...]], seeds: Sequence[int]
) -> Plan:
    """Return the runs of `teacher` on cells of a release with other seeds, one cell after the other.

    Places are environment, challenge, body, student and level of expert knowledge of each cell.

    Raises:
        ValueError: a teacher that cannot run, or a release that this version cannot repeat.
    """
    known = {
        (spec.environment, spec.challenge, spec.embodiment, spec.student, setting.level.value): setting
        for setting in _settings(released, ())
        for spec in [setting.template]
    }
    settings = [replace(known[place], seeds=tuple(seeds)) for place in places]  # type: ignore[index]
    planned = [each for setting in settings for each in _runs(setting, teacher, released)]
    size = f"{counted(len(places), 'cell')} of {released.store} x {counted(len(seeds), 'seed')}"
    return Plan(name, size, tuple(spec for spec, _ in planned), tuple(row for _, row in planned))


def _settings(released: Results, core: Collection[str]) -> list[_Setting]:
    """Return the settings of a release's cells, in the order of its experiments' names."""
    specs = {manifest.run.run_id: manifest.run.spec for manifest in released.runs()}
    if not specs:
        raise ValueError(f"{released.store} has no runs: there is nothing to repeat")
    if any(json.loads(spec).get("engine") == SIMULATED for spec in specs.values()):
        raise ValueError(
            f"{released.store} holds simulated students: repeat it with tma-ray simulate --teachers NAME "
            f"--results ROOT"
        )
    cells = [row for row in released.table(Table.CELLS).to_pylist() if row["run_id"] in specs]
    alone = set(specs) - {row["run_id"] for row in cells}
    cells += [
        {**row, "campaign": "", "experiment": SINGLE_RUNS}
        for row in released.table(Table.RUNS, alone).to_pylist()
    ]
    unknown = sorted(set(core) - {row["campaign"] for row in cells})
    if unknown:
        raise ValueError(f"{released.store} has no campaign {unknown[0]!r}")
    names = ("experiment", "environment", "challenge", "embodiment", "student", "expert_knowledge")
    found: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in cells if not core else [row for row in cells if row["campaign"] in core]:
        found.setdefault(tuple(row[name] for name in names), []).append(row)
    settings = []
    for key, rows in sorted(found.items()):
        text = specs[min(row["run_id"] for row in rows)]
        try:
            template = RunSpec.from_json(text, f"a spec of {released.store}")
        except ValueError as error:
            if isinstance(error, DamagedFileError):
                raise
            raise ValueError(f"{released.store} cannot be repeated: {error}") from error
        seeds = tuple(sorted({row["seed"] for row in rows}))
        settings.append(_Setting(key[0], KnowledgeLevel(key[-1]), template, seeds))
    return settings


def _runs(setting: _Setting, teacher: str, released: Results) -> Iterator[tuple[RunSpec, dict[str, Any]]]:
    """Yield the spec of each seed of a cell, and its row in the table of cells.

    Raises:
        ValueError: they differ from the runs of the release in more than the teacher; the message says how.
    """
    there = setting.template
    cell = Cell(
        environment=there.environment,
        challenge=there.challenge,
        embodiment=there.embodiment,
        student=there.student,
        teacher=teacher,
        expert_knowledge=setting.level,
    )
    first = replace(effective_spec(cell, 0, there.schedule), test_set=there.test_set)
    ours, theirs = _without_teacher(first), _without_teacher(there)
    differing = [name for name in sorted({*ours, *theirs}) if ours.get(name) != theirs.get(name)]
    if differing:
        said = "; ".join(
            f"{name}: {theirs.get(name)!r:.60} there, {ours.get(name)!r:.60} here" for name in differing
        )
        raise ValueError(
            f"this version cannot repeat {released.store} ({there.challenge}): {said}. Use the version of "
            f"tma_ray that it was made with, or another release"
        )
    for seed in setting.seeds:
        spec = replace(first, seed=seed)
        yield spec, cell_row(setting.experiment, cell, spec)


def _without_teacher(spec: RunSpec) -> dict[str, Any]:
    content = {name: value for name, value in spec.to_dict().items() if name not in TEACHER_FIELDS}
    for name in BY_PART:
        parts = content.get(name, {}).items()
        content[name] = {part: value for part, value in parts if part.partition(".")[0] != "teacher"}
    return content


DECIDED = (
    *("students", "embodiments", "expert_knowledge", "environment", "space", "environment_option"),
    *("test_set", *SCHEDULE, "independent_levels"),
)
"""Options whose values the release has."""


def run_like(name: str, place: str, core: Collection[str], options: CampaignOptions) -> int:
    """Run the cells and seeds of a release that the options choose; return the exit code.

    See `like_plan` and `run_plan` for further errors.

    Raises:
        ValueError: no teacher, or an option whose value the release has.
        ResultsRootError: `place` is not a results root.
    """
    given = [f"--{name.replace('_', '-')}" for name in DECIDED if getattr(options, name)]
    if given:
        raise ValueError(
            f"--like takes {', '.join(given)} from the release; --teachers, --challenges and --seeds choose"
        )
    if not options.teachers:
        raise ValueError("which teachers? Name them with --teachers, as in --teachers mine:Teacher")
    challenges, seeds = options.challenges or (), options.seeds or ()
    plan = like_plan(name, Results.open(place), options.teachers, core, challenges, seeds)
    return run_plan(plan, str(options.results), options, told=True)


def rerun_plan(root: str, names: Sequence[str], *, failed: bool) -> Plan:
    """Return the plan of unfinished runs of a root: by ids or beginnings of them, and all that `failed`.

    Raises:
        ValueError: nothing is named, no such run, one that is done, or a plug-in that was edited since:
            its runs would be others, of the campaign that it belongs to.
    """
    results = Results.open(root)
    chosen = {manifest.run.run_id: manifest for manifest in map(results.find, names)}
    if failed:
        chosen |= {m.run.run_id: m for m in results.runs() if m.status is RunStatus.FAILED}
    if not chosen:
        raise ValueError(
            f"no run of {root} failed" if failed else "pass run IDs or --failed, for all that failed"
        )
    whole = [m for m in chosen.values() if m.status is RunStatus.DONE]
    for manifest, found in Inspector(results.store).inspect_all(whole):
        if not found.damage:
            raise ValueError(f"run {manifest.run.run_id} is done: there is nothing to run again")
    specs = []
    for run_id, manifest in chosen.items():
        spec = RunSpec.from_json(manifest.run.spec, f"the spec of run {run_id}")
        if spec.run_id != run_id:
            raise ValueError(
                f"the spec of run {run_id} is not its own: its manifest was edited or is damaged"
            )
        try:
            import_plugins(spec, *spec.plugins)
        except ValueError as error:
            raise ValueError(
                f"run {run_id}: {error}; with an edited plug-in, start the campaign's own command"
            ) from error
        specs.append(spec)
    for spec in specs:
        fetch(results.store, spec)
    return Plan("rerun", f"{counted(len(chosen), 'run')} again", tuple(specs), ())
