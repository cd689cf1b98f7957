"""Plans that repeat a release with other teachers, or the unfinished runs of a results root."""

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tma_ray.campaign.options import SCHEDULE, CampaignOptions, flag
from tma_ray.campaign.plan import Plan, cell_row
from tma_ray.campaign.script import run_plan
from tma_ray.results import SIMULATED, SINGLE_RUNS, Inspector, Results, RunStatus, Table
from tma_ray.runs import Cell, RunSpec, effective_spec
from tma_ray.runs.inputs import fetch, import_plugins
from tma_ray.support.decoding import DamagedFileError
from tma_ray.support.texts import counted
from tma_ray.tasks import KnowledgeLevel

TEACHER_FIELDS = ("teacher", "teacher_hyperparameters", "expert_knowledge", "seed", "repeat")
"""Fields of a spec that may differ between teachers."""

COMPONENT_FIELDS = ("plugins", "algorithm_versions", "inputs")  # spec fields with one entry per component


@dataclass(frozen=True)
class _Setting:
    """Group of a release's cells that differ only in the teacher, with a template spec and all seeds."""

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
    """Return a plan that repeats a release's cells, seeds and settings with `teachers`.

    Runs are ordered by seed, then by cell.

    Args:
        name: name of the campaign.
        released: release to repeat.
        teachers: names in the teacher registry, or ``module:Name``.
        core: campaigns of the release to repeat; all by default.
        challenges: challenges of the release to repeat; all by default.
        seeds: seeds of the release to repeat; all by default.

    Raises:
        ValueError: if the release lacks a challenge, seed or campaign, a teacher cannot run, or this version
            cannot repeat the release.
    """
    settings = _settings(released, core)
    _check_released("challenge", challenges, dict.fromkeys(s.template.challenge for s in settings))
    settings = [s for s in settings if not challenges or s.template.challenge in challenges]
    _check_released("seed", seeds, sorted({seed for setting in settings for seed in setting.seeds}))
    if seeds:
        settings = [replace(s, seeds=tuple(seed for seed in s.seeds if seed in seeds)) for s in settings]
        settings = [s for s in settings if s.seeds]
    planned = [
        (index, spec, row)
        for setting in settings
        for teacher in teachers
        for index, (spec, row) in enumerate(_runs(setting, teacher, released))
    ]
    rows = tuple(row for _, _, row in planned)
    runs = {spec.run_id: spec for _, spec, _ in sorted(planned, key=lambda run: run[0])}
    cells = counted(len(settings) * len(teachers), "cell")
    size = f"{cells} like those of {released.store}, {len(rows):,} with their seeds"
    return Plan(name, size, tuple(runs.values()), rows)


def _check_released(kind: str, values: Collection[Any], released: Collection[Any]) -> None:
    for value in values:
        if value not in released:
            raise ValueError(f"the release has no {kind} {value!r}; it has {', '.join(map(str, released))}")


def trial_plans(
    name: str,
    released: Results,
    teacher: str,
    places: Sequence[tuple[str, ...]],
    looks: Sequence[Sequence[int]],
    steps: int | None = None,
) -> list[Plan]:
    """Return a plan for each interim look, of runs with `teacher` and new seeds on cells of a release.

    Runs are ordered by cell.

    Args:
        name: name of the campaign.
        released: release that has the cells.
        teacher: teacher to try.
        places: cells, as tuples of environment, challenge, body, student and level of expert knowledge.
        looks: seeds of every cell up to each look; the last look has all.
        steps: training budget of each run, up to that of the release; None for the latter.

    Raises:
        ValueError: if the teacher cannot run, this version cannot repeat the release, or runs of a cell
            depend on their budget before its end.
    """
    released_settings = {
        (spec.environment, spec.challenge, spec.embodiment, spec.student, setting.level.value): setting
        for setting in _settings(released, ())
        for spec in [setting.template]
    }
    settings = [replace(released_settings[cell], seeds=tuple(looks[-1])) for cell in places]  # type: ignore[index]
    planned = [run for setting in settings for run in _runs(setting, teacher, released, steps)]
    plans = []
    for seeds in looks:
        runs, rows = zip(*((spec, row) for spec, row in planned if spec.seed in seeds), strict=True)
        size = f"{counted(len(places), 'cell')} of {released.store} x {counted(len(seeds), 'seed')}"
        plans.append(Plan(name, size, runs, rows))
    return plans


def _settings(released: Results, core: Collection[str]) -> list[_Setting]:
    """Return the groups of a release's cells that differ only in the teacher, sorted by experiment."""
    specs = {manifest.run.run_id: manifest.run.spec for manifest in released.runs()}
    if not specs:
        raise ValueError(f"{released.store} has no runs: there is nothing to repeat")
    if any(json.loads(spec).get("engine") == SIMULATED for spec in specs.values()):
        raise ValueError(
            f"{released.store} holds simulated students: repeat it with tma-ray simulate --teachers NAME "
            f"--results ROOT"
        )
    cells = [row for row in released.table(Table.CELLS).to_pylist() if row["run_id"] in specs]
    single = set(specs) - {row["run_id"] for row in cells}
    cells += [
        {**row, "campaign": "", "experiment": SINGLE_RUNS}
        for row in released.table(Table.RUNS, single).to_pylist()
    ]
    unknown = sorted(set(core) - {row["campaign"] for row in cells})
    if unknown:
        raise ValueError(f"{released.store} has no campaign {unknown[0]!r}")
    names = ("experiment", "environment", "challenge", "embodiment", "student", "expert_knowledge")
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in cells if not core else [row for row in cells if row["campaign"] in core]:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    settings = []
    for key, rows in sorted(groups.items()):
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


def _runs(
    setting: _Setting, teacher: str, released: Results, steps: int | None = None
) -> Iterator[tuple[RunSpec, dict[str, Any]]]:
    """Yield, for each seed, the spec of the run with `teacher` and the run's row in the table of cells.

    Raises:
        ValueError: if the specs differ from the release's in more than the teacher and the budget `steps`.
    """
    template = setting.template
    cell = Cell(
        environment=template.environment,
        challenge=template.challenge,
        embodiment=template.embodiment,
        student=template.student,
        teacher=teacher,
        expert_knowledge=setting.level,
    )
    first = replace(effective_spec(cell, 0, template.schedule), test_set=template.test_set)
    if differences := _differences(template, first):
        raise ValueError(
            f"this version cannot repeat {released.store} ({template.challenge}): {differences}. Use the "
            f"version of tma_ray that it was made with, or another release"
        )
    if steps is not None:
        schedule = replace(template.schedule, steps=steps)
        first = replace(effective_spec(cell, 0, schedule), test_set=template.test_set)
        if differences := _differences(template, first, {"schedule"}):
            raise ValueError(
                f"runs of {steps:,} steps are not the beginning of the release's in {template.challenge}: "
                f"{differences}. Choose cells without it"
            )
    for seed in setting.seeds:
        spec = replace(first, seed=seed)
        yield spec, cell_row(setting.experiment, cell, spec)


def _differences(old: RunSpec, new: RunSpec, ignored: Collection[str] = ()) -> str:
    """Return the fields in which two specs differ besides their teachers, as text."""
    there, here = _without_teacher(old), _without_teacher(new)
    return "; ".join(
        f"{name}: {there.get(name)!r:.60} there, {here.get(name)!r:.60} here"
        for name in sorted({*there, *here}.difference(ignored))
        if there.get(name) != here.get(name)
    )


def _without_teacher(spec: RunSpec) -> dict[str, Any]:
    content = {name: value for name, value in spec.to_dict().items() if name not in TEACHER_FIELDS}
    for name in COMPONENT_FIELDS:
        parts = content.get(name, {}).items()
        content[name] = {part: value for part, value in parts if part.partition(".")[0] != "teacher"}
    return content


RELEASED_OPTIONS = (
    *("students", "embodiments", "expert_knowledge", "environment", "space", "environment_option"),
    *("test_set", *SCHEDULE, "independent_levels"),
)
"""Options that ``--like`` refuses, since the release determines their values."""


def run_like(name: str, release: str, core: Collection[str], options: CampaignOptions) -> int:
    """Run other teachers on selected cells and seeds of a release, and return the exit code.

    See `like_plan` and `run_plan` for further errors.

    Raises:
        ValueError: if no teacher is named, or one of `RELEASED_OPTIONS` is given.
        ResultsRootError: if `release` is not a results root.
    """
    refused = [flag(name) for name in RELEASED_OPTIONS if getattr(options, name)]
    if refused:
        raise ValueError(
            f"--like takes {', '.join(refused)} from the release; --teachers, --challenges and --seeds choose"
        )
    if not options.teachers:
        raise ValueError("which teachers? Name them with --teachers, as in --teachers mine:Teacher")
    challenges, seeds = options.challenges or (), options.seeds or ()
    plan = like_plan(name, Results.open(release), options.teachers, core, challenges, seeds)
    return run_plan(plan, str(options.results), options, show_cost=True)


def rerun_plan(root: str, names: Sequence[str], *, failed: bool) -> Plan:
    """Return a plan of the unfinished runs `names` (ids or prefixes), and of all failed runs if `failed`.

    Raises:
        ValueError: if nothing is named, a run does not exist or is done, or an edited plug-in
            changes its id.
    """
    results = Results.open(root)
    chosen = {manifest.run.run_id: manifest for manifest in map(results.find, names)}
    if failed:
        chosen |= {m.run.run_id: m for m in results.runs() if m.status is RunStatus.FAILED}
    if not chosen:
        raise ValueError(
            f"no run of {root} failed" if failed else "pass run IDs or --failed, for all that failed"
        )
    done = [m for m in chosen.values() if m.status is RunStatus.DONE]
    for manifest, inspection in Inspector(results.store).inspect_all(done):
        if not inspection.damage:
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
