"""Commands that list names with descriptions, and describe this machine."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tma_ray.cli.json_output import add_json_option, print_json
from tma_ray.cli.records import doctor_record, list_record
from tma_ray.command_line import CommandParser
from tma_ray.commands.places import folder

KINDS = ("teachers", "students", "environments", "embodiments", "challenges", "test-sets", "experiments")


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    commands.add_parser(
        "doctor",
        help="describe what this machine offers a campaign",
        description="Describe what this machine offers a campaign: versions, physics engine, CPU, "
        "memory, GPU, Ray and free disk.",
        populate=_add_doctor,
    )
    commands.add_parser(
        "list",
        help="list teachers, students, environments and all else that has a name",
        description="List all that has a name, with a description: teachers, students, environments, "
        "bodies, challenges, test sets and experiments.",
        populate=_add_list,
    )


def _add_doctor(parser: CommandParser) -> None:

    parser.add_argument(
        "--results",
        type=folder,
        default=Path("results"),
        metavar="FOLDER",
        help="folder of results, whose disk is examined",
    )
    add_json_option(parser)
    parser.set_defaults(command=_doctor)


def _add_list(parser: CommandParser) -> None:

    parser.add_argument(
        "kind", nargs="?", choices=KINDS, metavar="KIND", help=f"list one kind only: {', '.join(KINDS)}"
    )
    add_json_option(parser)
    parser.set_defaults(command=_list)


def _doctor(options: argparse.Namespace) -> int:
    if options.json:
        print_json("doctor", doctor_record(options.results))
        return 0
    from tma_ray.campaign.doctor import show

    show(options.results)
    return 0


def _list(options: argparse.Namespace) -> int:
    descriptions = {kind: _descriptions(kind) for kind in ([options.kind] if options.kind else KINDS)}
    if options.json:
        print_json("list", list_record(descriptions))
        return 0
    from rich.table import Table

    from tma_ray.terminal import terminal

    console = terminal()
    for kind, described in descriptions.items():
        table = Table(box=None, show_header=False, padding=(0, 2, 0, 2), pad_edge=True)
        table.add_column(no_wrap=True)
        table.add_column()
        for name, text in described.items():
            table.add_row(name, text)
        console.print(f"{kind}:", highlight=False)
        console.print(table, highlight=False, markup=False)
    return 0


def _descriptions(kind: str) -> Mapping[str, str]:
    """Returns the names of a kind, each with one line that describes it."""
    from tma_ray.benchmark import CHALLENGES, EXPERIMENTS, load_test_set, shipped_test_sets
    from tma_ray.embodiments import embodiment_names, load_embodiment
    from tma_ray.envs import ENVIRONMENTS
    from tma_ray.students import STUDENTS
    from tma_ray.teachers import TEACHERS

    def body(name: str) -> str:
        made = load_embodiment(name)
        return f"{made.body_type.capitalize()} of {len(made.parts)} parts with {len(made.motors)} motors."

    def test_set(name: str) -> str:
        tests = load_test_set(name)
        return f"{len(tests)} tasks of {len(tests.dimensions)} dimensions."

    found: dict[str, Callable[[], Mapping[str, str]]] = {
        "teachers": TEACHERS.summaries,
        "students": STUDENTS.summaries,
        "environments": ENVIRONMENTS.summaries,
        "embodiments": lambda: {name: body(name) for name in embodiment_names()},
        "challenges": lambda: {f"{each.name} ({each.environment})": f"{each.title}." for each in CHALLENGES},
        "test-sets": lambda: {name: test_set(name) for name in shipped_test_sets()},
        "experiments": lambda: {each.name: f"{each.title}." for each in EXPERIMENTS},
    }
    return found[kind]()
