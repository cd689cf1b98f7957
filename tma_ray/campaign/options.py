"""Command-line options shared by campaigns, experiments, trials and single runs."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from tma_ray.benchmark import Tier
from tma_ray.campaign.plan import CampaignSpec
from tma_ray.campaign.settings import (
    COHORT_WIDTH,
    ROLLOUT_WORKER,
    ExecutionConfig,
    Nodes,
    Resources,
    TeacherPlacement,
    check_address,
    host_and_port,
)
from tma_ray.console.command_line import choice, value, values
from tma_ray.console.types import named, root
from tma_ray.results import Store, check_root
from tma_ray.runs import Cell, Placement, Schedule
from tma_ray.runs.placement import check_device
from tma_ray.support.component_names import join_name, nearest
from tma_ray.support.quantities import (
    COORDINATE,
    CORES,
    COUNT,
    GPUS,
    MEMORY,
    PROCESSES,
    SECONDS,
    SEED,
    WIDTH,
    refused,
)
from tma_ray.tasks import KnowledgeLevel

MAX_SEEDS = 100_000  # largest number of seeds in one option
OFF = "off"  # value of ``--cohort`` for runs that learn alone
SCHEDULE = tuple(field.name for field in fields(Schedule))  # names of the schedule's options


def names(text: str) -> tuple[str, ...]:
    """Parse comma-separated names."""
    listed = bodies(text)
    if not all(listed):
        raise refused(text, "expected names, separated by commas")
    return listed


def bodies(text: str) -> tuple[str, ...]:
    """Parse comma-separated names of bodies, empty for worlds without one."""
    return tuple(name.strip() for name in text.split(","))


def parse_assignment(text: str) -> tuple[str, str]:
    """Parse NAME=VALUE into a name and a value.

    Examples:
        >>> parse_assignment("swinging_creepers=true")
        ('swinging_creepers', 'true')
    """
    name, separator, value = text.partition("=")
    if not (name and separator):
        raise ValueError(f"{text!r}: expected NAME=VALUE")
    return name, value


def parse_space(text: str) -> dict[str, tuple[float, float]]:
    """Parse the bounds of a task space.

    Examples:
        >>> parse_space("stump_height=0:0.3,obstacle_spacing=3:6")
        {'stump_height': (0.0, 0.3), 'obstacle_spacing': (3.0, 6.0)}
    """
    space: dict[str, tuple[float, float]] = {}
    for name, bounds in map(parse_assignment, text.split(",")):
        try:
            low, high = map(COORDINATE, bounds.split(":"))
        except ValueError:
            raise ValueError(
                f"{name}={bounds}: expected DIMENSION=LOW:HIGH, as in stump_height=0:0.3"
            ) from None
        if low > high:
            raise ValueError(f"{name}={bounds}: the low bound is over the high one")
        if name in space:
            raise ValueError(f"{name} is given twice; give its bounds once")
        space[name] = (low, high)
    return space


def parse_hours(text: str) -> float:
    """Parse a duration such as 8h, 30min or 8 into hours."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(h|min)?", text.strip())
    hours = float(match[1]) / (60 if match[2] == "min" else 1) if match else 0.0
    if not 0 < hours < 100_000:  # a larger number must be a mistake
        raise refused(text, "expected a time such as 8h or 30min")
    return hours


def parse_points(text: str) -> float:
    """Parse a margin in percentage points."""
    points = float(text) if re.fullmatch(r"\d+(\.\d+)?", text.strip()) else 0.0
    if not 0 < points < 100:
        raise refused(text, "expected points of mastered tasks, over 0 and under 100")
    return points


def parse_seeds(text: str) -> tuple[int, ...]:
    """Parse a number of seeds ("4") or a list of seeds ("8-11", "0,5").

    Examples:
        >>> parse_seeds("3"), parse_seeds("8-10"), parse_seeds("0,5")
        ((0, 1, 2), (8, 9, 10), (0, 5))
    """
    valid = re.fullmatch(r"\d{1,19}(-\d{1,19}|(,\d{1,19})+)?", text, re.ASCII)
    numbers = tuple(map(int, re.findall(r"\d+", text))) if valid else (0,)
    seeds: Sequence[int] = range(numbers[0])
    if len(numbers) > 1:
        seeds = numbers if "," in text else range(numbers[0], numbers[1] + 1)
    if not seeds or seeds[-1] > SEED.most:
        raise refused(text, "expected a number (4), a range (8-11) or a list (0,5)")
    if len(seeds) > MAX_SEEDS or len(set(seeds)) < len(seeds):
        reason = f"more than {MAX_SEEDS:,} seeds" if len(seeds) > MAX_SEEDS else "a seed is given twice"
        raise refused(text, reason)
    return tuple(seeds)


def parse_levels(names: Sequence[str]) -> tuple[KnowledgeLevel, ...]:
    """Parse the names of levels of expert knowledge."""
    unknown = [name for name in names if name not in list(KnowledgeLevel)]
    if unknown:
        raise ValueError(
            f"unknown level of expert knowledge {unknown[0]!r}: {nearest(unknown[0], KnowledgeLevel)}"
            f"expected one of {', '.join(KnowledgeLevel)}"
        )
    return tuple(map(KnowledgeLevel, names))


def parse_device(text: str) -> str:
    """Check and return the name of a torch device, which this machine need not have."""
    check_device(text)
    return text


def parse_results(text: str) -> str:
    """Check and return the folder or address of a results root to write to."""
    if "://" not in root(text):
        Store.open(text).check_location()
    return text


def parse_source(text: str) -> str:
    """Check and return the folder or address of an existing results root or release."""
    try:
        check_root(Store.open(root(text)))
    except OSError as error:
        raise ValueError(str(error)) from error
    return text


def parse_address(text: str) -> str:
    """Check and return the address of a Ray cluster, which need not be reachable."""
    host_and_port(text)
    return text


def parse_cohort(text: str) -> int:
    """Parse the width of a cohort, with 0 for "off".

    Examples:
        >>> parse_cohort("48"), parse_cohort("off")
        (48, 0)
    """
    if text == OFF:
        return 0
    try:
        width: int = WIDTH(text)
    except ValueError:
        width = 0
    if not width:
        raise refused(text, f"expected a number of slots such as {COHORT_WIDTH}, or {OFF}")
    return width


WHAT = {"group": Group("what to run", sort_key=2)}
HOW = {"group": Group("how to run it", sort_key=3)}
"""Groups of options in help texts."""

Names = Annotated[tuple[str, ...] | None, value(names, "NAME,...", **WHAT)]
Steps = Annotated[int | None, value(COUNT, "N", **WHAT)]
ResultsRoot = Annotated[str | Path, value(parse_results, "ROOT")]
Device = Annotated[str, value(parse_device, "DEVICE", **HOW)]
Seconds = Annotated[float, value(SECONDS, "SECONDS", **HOW)]
Yes = Annotated[
    bool,
    Parameter(
        help="start what takes over an hour on this machine; without it that is asked at a terminal, and "
        "refused elsewhere or with --address",
        **HOW,
    ),
]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ScheduleOptions:
    """Options of the schedule; None keeps the default.

    Attributes:
        steps: training budget of each run, in environment steps
        evaluation_interval: environment steps between two evaluations on the test set
        probe_interval: environment steps between two probes of the curriculum
        probe_size: tasks that a probe asks the teacher for
        training_window: environment steps in a window of training statistics
    """

    steps: Steps = None
    evaluation_interval: Steps = None
    probe_interval: Steps = None
    probe_size: Steps = None
    training_window: Steps = None

    def schedule(self, schedule: Schedule) -> Schedule:
        """Return `schedule` updated with the options that are set."""
        options = {name: getattr(self, name) for name in SCHEDULE}
        return replace(schedule, **{name: number for name, number in options.items() if number is not None})


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CellOptions:
    """Options that apply to all cells.

    Attributes:
        space: other bounds of the task space, as in stump_height=0:0.3,obstacle_spacing=3:6 (default: the
            challenge's)
        environment_option: option of the environment, as in swinging_creepers=true; repeatable (default: the
            environment's)
        test_set: shipped test set, whole or every nth task (stump_tracks:every=2), or path of a CSV file
            (default: the challenge's)
    """

    space: Annotated[dict[str, tuple[float, float]] | None, value(parse_space, "SPACE", **WHAT)] = None
    environment_option: Annotated[
        tuple[tuple[str, str], ...], values(parse_assignment, "NAME=VALUE", **WHAT)
    ] = ()
    test_set: Annotated[str | None, value(named("the name of a test set"), "NAME", **WHAT)] = None

    def environment_name(self, name: str) -> str:
        """Return the name of an environment with these options appended."""
        return name + "".join(join_name("", {key: text}) for key, text in self.environment_option)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RunOptions(CellOptions, ScheduleOptions):
    """Options of a single run.

    Attributes:
        environment: registered name or module:Name
        challenge: challenge of the environment
        embodiment: body or path of its file, with parameters if wanted, as in spider:size=1.2
        student: student, with hyper-parameters if wanted, as in sac:learning_rate=3e-4
        teacher: teacher, with hyper-parameters if wanted, as in alp_gmm:fit_every=100
        expert_knowledge: knowledge of the teacher: none, low or high
        seed: seed of the run
        device: device of the networks, as cpu or cuda
        threads: number of torch's threads
        checkpoint_seconds: longest time between two checkpoints
        results: folder, s3:// or gs:// to write to
    """

    environment: Annotated[str, value(named("the name of an environment"), "NAME", **WHAT)] = Cell.environment
    challenge: Annotated[str, value(named("the name of a challenge"), "NAME", **WHAT)] = Cell.challenge
    embodiment: Annotated[str, value(str, "NAME", **WHAT)] = Cell.embodiment
    student: Annotated[str, value(named("the name of a student"), "NAME", **WHAT)] = Cell.student
    teacher: Annotated[str, value(named("the name of a teacher"), "NAME", **WHAT)] = Cell.teacher
    expert_knowledge: Annotated[str, value(named("the name of a level"), "LEVEL", **WHAT)] = str(
        Cell.expert_knowledge
    )
    seed: Annotated[int, value(SEED, "N", **WHAT)] = 0
    device: Device = Placement.device
    threads: Annotated[int, value(PROCESSES, "N", **HOW)] = Placement.threads
    checkpoint_seconds: Seconds = Placement.checkpoint_seconds
    yes: Yes = False
    results: ResultsRoot = "results"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ChoiceOptions(ScheduleOptions):
    """Options that select cells; None selects all.

    Attributes:
        teachers: teachers, with hyper-parameters if wanted, as in alp_gmm:fit_every=100,riac
        students: students, with hyper-parameters if wanted, as in sac:learning_rate=3e-4,ppo
        challenges: challenges of the environment
        embodiments: bodies or paths of their files, with parameters if wanted, as in spider:size=1.2
        expert_knowledge: levels of expert knowledge offered to the teachers: none, low, high
        seeds: number of seeds (4), or given ones: a range (8-11) or a list (0,5)
        independent_levels: repeat runs with other random numbers that cells of several levels could share
    """

    teachers: Names = None
    students: Names = None
    challenges: Names = None
    embodiments: Annotated[tuple[str, ...] | None, value(bodies, "NAME,...", **WHAT)] = None
    expert_knowledge: Annotated[tuple[str, ...] | None, value(names, "LEVEL,...", **WHAT)] = None
    seeds: Annotated[tuple[int, ...] | None, value(parse_seeds, "SEEDS", **WHAT)] = None
    independent_levels: Annotated[bool, Parameter(**WHAT)] = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ExecutionOptions:
    """Options of the execution on Ray.

    Attributes:
        local: start a Ray on this machine, whatever RAY_ADDRESS says
        address: host:port of a Ray cluster's head, or auto (default: RAY_ADDRESS, else a Ray on this machine)
        autoscaling: accept runs that fit no node of today's, since the cluster adds nodes
        cpus_per_run: cores that a run occupies
        gpus_per_run: GPUs that a run occupies which learns alone: a share of one, as 0.25, or a whole number
        memory_per_run: memory that a run occupies
        device: device of the networks, as cpu or cuda
        cohort: runs that learn together, one learner for each WIDTH or for each GPU; or off
        teacher_placement: teachers in actors of their own, or in the processes of their runs
        checkpoint_seconds: longest time between two checkpoints of a run
        outage_seconds: time without the storage of the results after which runs count as lost
        unreachable_seconds: time without an answer after which a run or a cohort's learner counts as lost
        start_from: results root or release whose runs are copied first and not repeated (default: none)
        dry_run: print the size of what would run, and stop
    """

    local: Annotated[bool, Parameter(**HOW)] = False
    address: Annotated[str | None, value(parse_address, "ADDRESS", **HOW)] = None
    autoscaling: Annotated[bool, Parameter(**HOW)] = False
    cpus_per_run: Annotated[float | None, value(CORES, "X", **HOW)] = None
    gpus_per_run: Annotated[float, value(GPUS, "X", **HOW)] = Resources.gpus
    memory_per_run: Annotated[float | None, value(MEMORY, "GIB", **HOW)] = None
    device: Device = ExecutionConfig.device
    cohort: Annotated[int | None, value(parse_cohort, "WIDTH", **HOW)] = None
    teacher_placement: Annotated[TeacherPlacement, choice(TeacherPlacement, **HOW)] = TeacherPlacement.ACTOR
    checkpoint_seconds: Seconds = ExecutionConfig.checkpoint_seconds
    outage_seconds: Seconds = ExecutionConfig.outage_seconds
    unreachable_seconds: Seconds = ExecutionConfig.unreachable_seconds
    start_from: Annotated[str | Path | None, value(parse_source, "ROOT", **HOW)] = None
    dry_run: Annotated[bool, Parameter(**HOW)] = False
    yes: Yes = False

    def __post_init__(self) -> None:
        if self.local and self.address:
            raise ValueError("argument --address: not allowed with --local, which is a Ray on this machine")

    def config(self) -> ExecutionConfig:
        """Return the configuration of a campaign's execution."""
        options = {"cpus": self.cpus_per_run, "memory_gib": self.memory_per_run}
        resources = {name: number for name, number in options.items() if number is not None}
        return ExecutionConfig(
            resources=Resources(**resources, gpus=self.gpus_per_run),
            rollout_worker=replace(ROLLOUT_WORKER, **resources),
            device=self.device,
            cohort=self.cohort,
            teachers=self.teacher_placement,
            checkpoint_seconds=self.checkpoint_seconds,
            outage_seconds=self.outage_seconds,
            unreachable_seconds=self.unreachable_seconds,
            autoscaling=self.autoscaling,
        )

    def chosen_address(self) -> str | None:
        """Return the cluster's address, or None for this machine."""
        return None if self.local else self.address or os.environ.get("RAY_ADDRESS") or None

    def nodes(self, device: str) -> Nodes | None:
        """Return the cluster's nodes for runs on `device`, or None for this machine and for dry runs.

        Raises:
            ValueError: if the address is malformed.
            ConnectionError: if no cluster answers there, or it has another token.
        """
        address = self.chosen_address()
        if address is None or self.dry_run:
            return None
        from tma_ray.campaign.cluster.nodes import cluster_nodes  # imported late, since it imports ray

        check_address(address)
        return cluster_nodes(address, gpus=device != "cpu", autoscaling=self.autoscaling)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CampaignOptions(ExecutionOptions, CellOptions, ChoiceOptions):
    """Options of a campaign.

    Attributes:
        environment: registered name or module:Name
        results: folder, s3:// or gs:// to write to
    """

    environment: Annotated[str | None, value(named("the name of an environment"), "NAME", **WHAT)] = None
    results: ResultsRoot = "results"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ExperimentOptions(ExecutionOptions, ChoiceOptions):
    """Options of an experiment of the benchmark.

    Attributes:
        tier: size of the experiment
        stage: part of an experiment that has stages, as core (default: all)
        results: folder, s3:// or gs:// to write to
    """

    tier: Annotated[Tier, choice(Tier, **WHAT)] = Tier.PAPER
    stage: Annotated[str | None, value(named("the name of a stage"), "NAME", **WHAT)] = None
    results: ResultsRoot = "results"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class TrialOptions(ExecutionOptions):
    """Options of a trial.

    Attributes:
        against: release to compare with (default: the newest complete one with the budget of tier lite)
        cells: cells of it: challenges, or challenge/body where it has several bodies; 'all' for all (default:
            its default cells)
        margin: difference that does not matter, of tasks mastered over training (default: 2.5)
        steps: training budget of each run, after which the release's runs are measured too (default: theirs)
        budget: time that it may take here (default: none)
        simulated: rehearse it on simulated students: the same design, minutes instead of hours
        jobs: number of processes with --simulated
        results: folder, s3:// or gs:// to write to
    """

    against: Annotated[str | None, value(named("a release"), "BASELINE", **WHAT)] = None
    cells: Names = None
    margin: Annotated[float | None, value(parse_points, "POINTS", **WHAT)] = None
    steps: Steps = None
    budget: Annotated[float | None, value(parse_hours, "HOURS", **WHAT)] = None
    simulated: Annotated[bool, Parameter(**WHAT)] = False
    jobs: Annotated[int, value(PROCESSES, "N", **HOW)] = 2
    results: ResultsRoot = "results"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.simulated and self.steps:
            raise ValueError("argument --steps: not allowed with --simulated, whose students have no steps")


EXECUTION_DEFAULTS = {
    "--cpus-per-run": f"{Resources.cpus:g}, in a cohort {ROLLOUT_WORKER.cpus:g}",
    "--memory-per-run": f"{Resources.memory_gib:g}, in a cohort {ROLLOUT_WORKER.memory_gib:g}",
    "--cohort": f"{COHORT_WIDTH} with --device cuda, else {OFF}",
}
"""Defaults of `ExecutionOptions` in help texts, by option."""


def flag(name: str) -> str:
    """Return the command-line option of an attribute, as in ``--dry-run``."""
    return f"--{name.replace('_', '-')}"


EXPERIMENT_DEFAULTS = EXECUTION_DEFAULTS | {
    flag(field.name): "the experiment's" for field in fields(ChoiceOptions)
}
"""Defaults of `ExperimentOptions` in help texts, by option."""


def schedule_defaults(schedule: Schedule) -> dict[str, str]:
    """Return a schedule's values by option, to be shown as defaults in a help text."""
    return {flag(name): f"{getattr(schedule, name):,}" for name in SCHEDULE}


def campaign_defaults(campaign: CampaignSpec) -> dict[str, str]:
    """Return a campaign's values by option, to be shown as defaults in a help text."""
    options = ("teachers", "students", "challenges", "embodiments", "expert_knowledge", "environment")
    defaults = {}
    for name in options:
        values = dict.fromkeys(str(getattr(cell, name.removesuffix("s"))) for cell in campaign.cells)
        defaults[flag(name)] = ",".join(values) or "none"
    first = campaign.seeds == tuple(range(len(campaign.seeds)))
    seeds = str(len(campaign.seeds)) if first else ",".join(map(str, campaign.seeds))
    return {**EXECUTION_DEFAULTS, **defaults, "--seeds": seeds, **schedule_defaults(campaign.schedule)}


def chosen_campaign(campaign: CampaignSpec, options: CampaignOptions) -> CampaignSpec:
    """Return `campaign` with cells, seeds and schedule changed by `options`.

    Every cell is repeated for each combination of the values in `options`; duplicates are left out.
    """
    choices: dict[str, Sequence[Any] | None] = {
        "environment": (options.environment,) if options.environment else None,
        "challenge": options.challenges,
        "embodiment": options.embodiments,
        "student": options.students,
        "teacher": options.teachers,
        "expert_knowledge": parse_levels(options.expert_knowledge) if options.expert_knowledge else None,
        "test_set": (options.test_set,) if options.test_set else None,
        "space": (options.space,) if options.space else None,
    }
    cells = list(campaign.cells)
    for name, selected in choices.items():
        if selected is not None:
            cells = [replace(cell, **{name: item}) for cell in cells for item in selected]
    unique: list[Cell] = []
    for cell in cells:
        changed = replace(cell, environment=options.environment_name(cell.environment))
        if changed not in unique:
            unique.append(changed)
    return replace(
        campaign,
        cells=tuple(unique),
        seeds=options.seeds if options.seeds is not None else campaign.seeds,
        schedule=options.schedule(campaign.schedule),
        independent_levels=campaign.independent_levels or options.independent_levels,
    )
