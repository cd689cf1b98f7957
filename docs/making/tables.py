"""Tables generated from the code and from releases, which `write_generated` inserts into pages."""

from __future__ import annotations

import csv
import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
from release_tables import (
    answer,
    budget_rule,
    later_teachers,
    leaderboard,
    learning_of_releases,
    releases,
    sensitivity,
    simulated_and_paper,
    simulated_students,
    trials,
    untrained,
)

from analysis.baselines import BaselineKind, baselines, newest_release
from analysis.commands.leaderboards import trials_markdown
from analysis.commands.releases import findings
from tma_ray import cli
from tma_ray.benchmark import CHALLENGES, KNOWLEDGE_REQUIREMENTS, challenges_of, load_test_set
from tma_ray.cli.json_output import KEYS
from tma_ray.console import command_line
from tma_ray.curriculum import teacher_needs
from tma_ray.embodiments import embodiment_names, load_embodiment
from tma_ray.envs import ENVIRONMENTS, make_environment
from tma_ray.results import SCHEMAS, Table
from tma_ray.students import PPOHyperparameters, SACHyperparameters
from tma_ray.tasks import KnowledgeLevel, TaskSpace
from tma_ray.teachers import TEACHERS

ROOT = Path(__file__).parents[2]

MEASURED = (
    "pairs_decided",
    "false_findings",
    "pairing_of_measurements",
    "pairing_of_releases",
    "interval_coverage",
    "statements_decided",
    "paper_claims",
    "playground",
    "agreement_coverage",
    "tau_coverage",
    "trial_cells",
    "teacher_cost",
    "long_runs_done",
    "long_runs_mastered",
    "long_runs_decided",
    "long_runs_agreement",
    "long_runs_orders",
    "long_runs_predictions",
)
"""Tables of `benchmarks/measured`; its other files contain evaluations."""

DATA = {
    "fidelity": sorted((ROOT / "docs" / "fidelity").glob("*.csv")),
    "measured": [ROOT / "benchmarks" / "measured" / f"{name}.csv" for name in MEASURED],
}
"""CSV files that pages show as tables, by the first word of the generated part's name."""

NONE = "\N{EN DASH}"
"""Content of an empty cell."""

ABOUT: Mapping[Table, str] = {
    Table.RUNS: "One run: what it is, and what has become of it.",
    Table.ATTEMPTS: "One attempt at a run: a process that took it up, where, and how that ended.",
    Table.CELLS: "One cell with one seed of a campaign, and the run that it comes down to.",
    Table.EVALUATIONS: "One test task at one evaluation.",
    Table.TRAINING: "One window of training; `step` is its end.",
    Table.EPISODES: "One training episode; `step` is its end.",
    Table.CURRICULUM: "One task that the teacher named when its curriculum was probed.",
    Table.TEACHER_LOG: "One update of a teacher's task distribution, drawable for any teacher.",
}


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(_cell(value) for value in line)} |" for line in lines)


def data_table(path: Path) -> str:
    """Return a CSV file with a header as a Markdown table, with dashes in empty cells."""
    with path.open(encoding="utf-8", newline="") as lines:
        head, *rows = csv.reader(lines)
    return markdown(head, [[cell or NONE for cell in row] for row in rows])


def meanings(kind: type) -> dict[str, str]:
    """Return the descriptions of attributes in the docstrings of a class and its bases."""
    found: dict[str, str] = {}
    for each in reversed(kind.__mro__):
        _, _, section = inspect.cleandoc(each.__doc__ or "").partition("Attributes:\n")
        for name, text in re.findall(r"^ {4}(\w+): (.*(?:\n {8,}.*)*)", section, re.MULTILINE):
            found[name] = re.sub(r"\s+", " ", text)
    return found


def hyperparameters(kind: type) -> str:
    """Return a table of the constructor's fields of a dataclass: name, default, meaning."""
    says = meanings(kind)
    return markdown(
        ("hyper-parameter", "default", "meaning"),
        [
            (f"`{field.name}`", _value(field.default), says[field.name])
            for field in dataclasses.fields(kind)
            if field.init
        ],
    )


def teacher(name: str) -> str:
    """Return the levels of expert knowledge that a teacher uses, and its hyper-parameters."""
    kind = TEACHERS.get(name)
    least, *higher = kind.knowledge_levels
    needs = "no expert knowledge" if least is KnowledgeLevel.NONE else f"expert knowledge of level {least}"
    use = f"behaves differently at level {' or '.join(higher)}" if higher else "uses no other"
    line = f"`{name}` needs {needs}, and {use}."
    has_any = any(field.init for field in dataclasses.fields(kind))
    return f"{line}\n\n{hyperparameters(kind)}" if has_any else f"{line} It has no hyper-parameters."


def needs_of_teachers() -> str:
    """Return a table of what teachers need from a training loop."""
    rows = [
        (
            f"`{row.teacher}`",
            ", ".join(f"`{name}`" for name in filter(None, row.needs.split(", "))) or NONE,
            row.expert_knowledge,
            "yes" if row.several_worlds else "no",
        )
        for row in teacher_needs().itertuples()
    ]
    return markdown(("teacher", "functions", "least expert knowledge", "several environments"), rows)


def knowledge_requirements() -> str:
    """Return a table of the expert knowledge that teachers require, use or ignore."""
    head = ("teacher", "initial distribution", "target distribution", "range of returns", "runs at level")
    return markdown(
        head,
        [
            (f"`{name}`", *dataclasses.astuple(needs), ", ".join(_levels(name)))
            for name, needs in KNOWLEDGE_REQUIREMENTS.items()
        ],
    )


def challenges(environment: str) -> str:
    """Return a table of the challenges of an environment, with task spaces and tests."""
    known = challenges_of(environment)
    head = (
        "name",
        "what",
        "task space, where it is not the original",
        "test sets",
        "the student forgets",
        "cuts",
    )
    return markdown(
        head,
        [
            (
                f"`{name}`",
                each.title,
                _bounds(each.task_space, known["original"].task_space),
                ", ".join(
                    f"`{test}`" for test in dict.fromkeys([each.test_set, *each.other_test_sets.values()])
                ),
                " and ".join(f"at {100 * share:g} %" for share in each.resets) or NONE,
                each.cuts or NONE,
            )
            for name, each in known.items()
        ],
    )


def task_space(environment: str) -> str:
    """Return a table of the dimensions of an environment's tasks: bounds of task space and valid domain."""
    made = make_environment(environment)
    space: TaskSpace = challenges_of(environment)["original"].task_space
    domain = made.get_wrapper_attr("valid_domain")
    made.close()
    return markdown(
        ("dimension", "task space", "valid domain", "unit"),
        [
            (f"`{one.name}`", _range(one.low, one.high), _range(wide.low, wide.high), one.unit or NONE)
            for one, wide in zip(space.dimensions, domain.dimensions, strict=True)
        ],
    )


def embodiments() -> str:
    """Return a table of the shipped bodies."""
    bodies = sorted(map(load_embodiment, embodiment_names()), key=lambda body: body.body_type)
    return markdown(
        ("name", "kind", "parts", "motors", "grips", "mass", "survives under water", "survives outside"),
        [
            (
                f"`{body.name}`",
                body.body_type,
                len(body.parts),
                len(body.motors),
                len(body.grip_sensors) or NONE,
                f"{sum(piece.mass for piece in (*body.parts, *body.grip_sensors)):.1f} kg",
                _steps(body.steps_survivable_under_water),
                _steps(body.steps_survivable_outside_water),
            )
            for body in bodies
        ],
    )


def test_sets() -> str:
    """Return a table of the shipped test sets, with their challenges."""
    users: dict[str, list[str]] = {}
    for each in CHALLENGES:
        for name in dict.fromkeys([each.test_set, *each.other_test_sets.values()]):
            users.setdefault(name, []).append(f"{each.name} ({each.environment})")
    return markdown(
        ("test set", "tasks", "challenges"),
        [(f"`{name}`", len(load_test_set(name).tasks), ", ".join(of)) for name, of in sorted(users.items())],
    )


def columns(table: Table) -> str:
    """Return the description of a table's rows, and a list of its columns."""
    rows = [
        (
            f"`{field.name}`" + (" (may be absent)" if field.nullable else ""),
            f"`{_type(field.type)}`",
            (field.metadata or {}).get(b"unit", b"").decode() or NONE,
        )
        for field in SCHEMAS[table]
    ]
    return f"{ABOUT[table]}\n\n{markdown(('column', 'type', 'unit'), rows)}"


def all_columns() -> str:
    """Return `columns` of all tables, with a heading for each."""
    return "\n\n".join(f"### {table}\n\n{columns(table)}" for table in Table)


def commands() -> str:
    """Return the ``--help`` of every command."""
    return "\n\n".join(f"## {name}\n\n```text\n{text}```" for name, text in helps())


def json_keys() -> str:
    """Return a table of the keys of the JSON that commands print."""
    return markdown(
        ("command", "key", "value"),
        [
            (f"`tma-ray {command}`", f"`{key}`", meaning)
            for command, keys in KEYS.items()
            for key, meaning in keys.items()
        ],
    )


def metavars() -> str:
    """Return a table of the placeholders in helps, such as FOLDER, and their meanings."""
    return markdown(
        ("word", "value"), [(f"`{word}`", meaning) for word, meaning in command_line.METAVARS.items()]
    )


def helps() -> Iterator[tuple[str, str]]:
    """Yield the names and helps (80 characters wide) of all commands."""
    app = cli.app()
    for words, _ in command_line.commands(app):
        yield " ".join(("tma-ray", *words)), command_line.help_text(app, words)


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|")


def _value(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, bool) or value is None:
        return str(value)
    return f"{value:,}" if isinstance(value, int) else str(value)


def _levels(name: str) -> list[str]:
    return [
        level.value for level in KnowledgeLevel if level.rank >= TEACHERS.get(name).knowledge_levels[0].rank
    ]


def _range(low: float, high: float) -> str:
    return f"{low:g}" if low == high else f"{low:g} to {high:g}".replace("-", "\N{MINUS SIGN}")


def _bounds(space: TaskSpace, original: TaskSpace) -> str:
    """Return the bounds of dimensions that differ from the original space, as text."""
    pairs = zip(space.dimensions, original.dimensions, strict=True)
    others = (f"{one.name} {_range(one.low, one.high)}" for one, first in pairs if one != first)
    return "; ".join(others) or NONE


def _steps(steps: int | None) -> str:
    return "always" if steps is None else f"{steps} steps"


def _type(kind: pa.DataType) -> str:
    """Return a short name of a column type, regardless of its encoding."""
    if pa.types.is_dictionary(kind):
        return str(kind.value_type)
    if pa.types.is_list(kind):
        return f"list of {_type(kind.value_type)}"
    if pa.types.is_struct(kind):
        return "{" + ", ".join(f"{field.name}: {_type(field.type)}" for field in kind) + "}"
    if pa.types.is_map(kind):
        return f"map of {_type(kind.key_type)} to {_type(kind.item_type)}"
    return str(kind)


GENERATED: dict[str, Callable[[], str]] = {
    **{f"teacher {name}": lambda name=name: teacher(name) for name in TEACHERS.names()},
    "student ppo": lambda: hyperparameters(PPOHyperparameters),
    "student sac": lambda: hyperparameters(SACHyperparameters),
    "knowledge requirements": knowledge_requirements,
    "teacher needs": needs_of_teachers,
    **{f"challenges {name}": lambda name=name: challenges(name) for name in ENVIRONMENTS.names()},
    **{f"task space {name}": lambda name=name: task_space(name) for name in ENVIRONMENTS.names()},
    "embodiments": embodiments,
    "test sets": test_sets,
    "columns": all_columns,
    "commands": commands,
    "json keys": json_keys,
    "metavars": metavars,
    "answer": answer,
    **{
        f"leaderboard {each.manifest.name}": functools.partial(leaderboard, each.manifest.name)
        for each in baselines()
        if each.manifest.kind is BaselineKind.RUNS
    },
    "trials": trials,
    "joined trials": lambda: "\n\n".join(trials_markdown("lite-2")),
    "sensitivity": sensitivity,
    "simulated students": simulated_students,
    "simulated and paper": simulated_and_paper,
    "baselines": releases,
    "learning of releases": learning_of_releases,
    "findings": lambda: findings(newest_release().location),
    "untrained": untrained,
    "later teachers": later_teachers,
    "budget rule": budget_rule,
    **{
        f"{kind} {path.stem}": functools.partial(data_table, path)
        for kind, files in DATA.items()
        for path in files
    },
}
"""Functions that return the generated parts of pages, by name."""
