"""Repetitions: a release for other teachers, and unfinished runs of a results root."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tma_ray.campaign.costs import estimate
from tma_ray.campaign.options import (
    SCHEDULE,
    CampaignOptions,
    ExecutionOptions,
    chosen_nodes,
    chosen_settings,
)
from tma_ray.campaign.plan import Plan, cell_row
from tma_ray.campaign.script import run_plan
from tma_ray.commands.texts import counted
from tma_ray.decoding import DamagedFileError
from tma_ray.results import SIMULATED, Inspector, Results, RunRecord, RunStatus, Store, Table, check_usable
from tma_ray.runs import Cell, RunSpec, effective_spec
from tma_ray.runs.inputs import fetch, import_plugins
from tma_ray.tasks import KnowledgeLevel
from tma_ray.terminal import terminal

TEACHER_FIELDS = ("teacher", "teacher_hyperparameters", "expert_knowledge", "seed", "repeat")
"""Fields of a spec in which another teacher may differ."""

SINGLE_RUNS = "single_runs"
"""Name of the experiment of runs that belong to no campaign."""

BY_PART = ("plugins", "algorithm_versions", "inputs")
"""Fields of a spec with an entry for each of its parts."""


@dataclass(frozen=True)
class _Setting:
    """Cells of a release that differ in their teachers and seeds only.

    Attributes:
        experiment: name of the experiment that they belong to.
        level: expert knowledge offered.
        template: spec of one of their runs.
        seeds: seeds of all of them, rising.
    """

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
    settings = _chosen(_settings(released, core), challenges, seeds)
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


def trial_plan(
    name: str, released: Results, teacher: str, places: Sequence[tuple[str, ...]], seeds: Sequence[int]
) -> Plan:
    """Return the runs of `teacher` on cells of a release with other seeds, one cell after the other.

    Args:
        name: name of the campaign.
        released: the release.
        teacher: name in the teacher registry, or ``module:Name``.
        places: environment, challenge, body, student and level of expert knowledge of each cell, in order.
        seeds: seeds of every cell.

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


def _runs(setting: _Setting, teacher: str, released: Results) -> Iterator[tuple[RunSpec, dict[str, Any]]]:
    """Yield the spec of each seed of a cell, and its row in the table of cells."""
    cell = _cell(setting, teacher)
    spec = effective_spec(cell, 0, setting.template.schedule)
    first = _checked(replace(spec, test_set=setting.template.test_set), setting, released)
    for seed in setting.seeds:
        spec = replace(first, seed=seed)
        yield spec, {**cell_row(setting.experiment, cell, spec), "seed": seed, "run_id": spec.run_id}


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
    return [
        _Setting(
            key[0],
            KnowledgeLevel(key[-1]),
            _template(specs[min(row["run_id"] for row in rows)], released),
            tuple(sorted({row["seed"] for row in rows})),
        )
        for key, rows in sorted(found.items())
    ]


def _template(spec: str, released: Results) -> RunSpec:
    try:
        return RunSpec.from_json(spec, f"a spec of {released.store}")
    except DamagedFileError:
        raise
    except ValueError as error:
        raise ValueError(f"{released.store} cannot be repeated: {error}") from error


def _chosen(
    settings: Sequence[_Setting], challenges: Collection[str], seeds: Collection[int]
) -> list[_Setting]:
    known = dict.fromkeys(setting.template.challenge for setting in settings)
    for challenge in challenges:
        if challenge not in known:
            raise ValueError(f"the release has no challenge {challenge!r}; it has {', '.join(known)}")
    kept = [each for each in settings if not challenges or each.template.challenge in challenges]
    if not seeds:
        return kept
    there = sorted({seed for setting in kept for seed in setting.seeds})
    for seed in seeds:
        if seed not in there:
            raise ValueError(f"the release has no seed {seed}; it has {', '.join(map(str, there))}")
    narrowed = (replace(each, seeds=tuple(s for s in each.seeds if s in seeds)) for each in kept)
    return [each for each in narrowed if each.seeds]


def _cell(setting: _Setting, teacher: str) -> Cell:
    spec = setting.template
    return Cell(
        environment=spec.environment,
        challenge=spec.challenge,
        embodiment=spec.embodiment,
        student=spec.student,
        teacher=teacher,
        expert_knowledge=setting.level,
    )


def _checked(spec: RunSpec, setting: _Setting, released: Results) -> RunSpec:
    """Return `spec` if it differs from the runs of the release in its teacher only.

    Raises:
        ValueError: it does not; the message names what differs.
    """
    ours, theirs = _without_teacher(spec), _without_teacher(setting.template)
    differing = [name for name in sorted({*ours, *theirs}) if ours.get(name) != theirs.get(name)]
    if differing:
        said = "; ".join(
            f"{name}: {_short(theirs.get(name))} there, {_short(ours.get(name))} here" for name in differing
        )
        raise ValueError(
            f"this version cannot repeat {released.store} ({setting.template.challenge}): {said}. Use the "
            f"version of tma_ray that it was made with, or another release"
        )
    return spec


def _without_teacher(spec: RunSpec) -> dict[str, Any]:
    content = {name: value for name, value in spec.to_dict().items() if name not in TEACHER_FIELDS}
    for name in BY_PART:
        parts = content.get(name, {}).items()
        content[name] = {part: value for part, value in parts if part.partition(".")[0] != "teacher"}
    return content


def _short(value: Any) -> str:
    return f"{value!r:.60}"


DECIDED = (
    *(
        "students",
        "embodiments",
        "expert_knowledge",
        "environment",
        "space",
        "environment_option",
        "test_set",
    ),
    *SCHEDULE,
    "independent_levels",
)
"""Options whose values the release has."""


def run_like(name: str, place: str, core: Collection[str], options: CampaignOptions) -> int:
    """Run the cells and seeds of a release that the options choose; return the exit code.

    Args:
        name: campaign's name in the results.
        place: folder or address of the release.
        core: campaigns of the release to repeat; empty for all.
        options: choice of teachers, challenges and seeds, and the execution.

    Raises:
        ValueError: no teacher, an option whose value the release has, or what `like_plan` refuses.
        ResultsRootError: `place` is not a results root.
        ConnectionError: no cluster answers.
        RootInUseError: another campaign is running on the results root.
    """
    given = [f"--{name.replace('_', '-')}" for name in DECIDED if getattr(options, name)]
    if given:
        raise ValueError(
            f"--like takes {', '.join(given)} from the release; --teachers, --challenges and --seeds choose"
        )
    if not options.teachers:
        raise ValueError("which teachers? Name them with --teachers, as in --teachers mine:Teacher")
    plan = like_plan(
        name,
        Results.open(place),
        options.teachers,
        core,
        options.challenges or (),
        options.seeds or (),
    )
    if not options.dry_run:
        check_usable(Store.open(options.results))
    cost = estimate(plan, chosen_settings(options), nodes=chosen_nodes(options))
    terminal().print(cost.describe(), highlight=False, soft_wrap=True)
    return run_plan(plan, str(options.results), options, cost.throughputs)


NAME = "rerun"
"""Name of a rerun, in place of a campaign's."""


def rerun(root: str, names: Sequence[str], options: ExecutionOptions, *, failed: bool) -> int:
    """Run unfinished runs of a root, from their checkpoints if they have some; see `rerun_plan`.

    Raises:
        ValueError: nothing is named, no such run, or a plug-in that was edited since.
    """
    return run_plan(rerun_plan(root, names, failed=failed), root, options)


def rerun_plan(root: str, names: Sequence[str], *, failed: bool) -> Plan:
    """Return the plan of unfinished runs of a root.

    Args:
        root: folder or URI of a results root.
        names: ids of runs, or unambiguous prefixes of them.
        failed: True for all runs that failed.

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
    specs = tuple(_spec(manifest.run) for manifest in chosen.values())
    for spec in specs:
        fetch(results.store, spec)
    return Plan(NAME, f"{counted(len(chosen), 'run')} again", specs, ())


def _spec(run: RunRecord) -> RunSpec:
    spec = RunSpec.from_json(run.spec, f"the spec of run {run.run_id}")
    if spec.run_id != run.run_id:
        raise ValueError(
            f"the spec of run {run.run_id} is not its own: its manifest was edited or is damaged"
        )
    try:
        import_plugins(spec, *spec.plugins)
    except ValueError as error:
        raise ValueError(
            f"run {run.run_id}: {error}; with an edited plug-in, start the campaign's own command"
        ) from error
    return spec
