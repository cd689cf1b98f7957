"""Commands that say what there is: names, and what this machine offers."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

KINDS = ("teachers", "students", "environments", "embodiments", "challenges", "test-sets", "experiments")


def add_commands(commands: Any) -> None:
    """Adds them to the subparsers `commands`."""
    doctor = commands.add_parser("doctor", help="what this machine offers a campaign")
    doctor.add_argument("--results", type=Path, default=Path("results"), metavar="FOLDER")
    doctor.set_defaults(command=_doctor)
    listing = commands.add_parser("list", help="what can be named: teachers, students, ...")
    listing.add_argument("kind", nargs="?", choices=KINDS)
    listing.set_defaults(command=_list)


def _doctor(options: argparse.Namespace) -> int:
    from tma_ray.campaign.doctor import show

    show(options.results)
    return 0


def _list(options: argparse.Namespace) -> int:
    for kind in [options.kind] if options.kind else KINDS:
        print(f"{kind}:", *_names(kind), sep="\n  ")
    return 0


def _names(kind: str) -> Sequence[str]:
    from tma_ray.benchmark import CHALLENGES, EXPERIMENTS, shipped_test_sets
    from tma_ray.embodiments import embodiment_names
    from tma_ray.envs import ENVIRONMENTS
    from tma_ray.students import STUDENTS
    from tma_ray.teachers import TEACHERS

    names: dict[str, Callable[[], Sequence[str]]] = {
        "teachers": TEACHERS.names,
        "students": STUDENTS.names,
        "environments": ENVIRONMENTS.names,
        "embodiments": embodiment_names,
        "challenges": lambda: [f"{challenge.name} ({challenge.environment})" for challenge in CHALLENGES],
        "test-sets": shipped_test_sets,
        "experiments": lambda: [f"{experiment.name}: {experiment.title}" for experiment in EXPERIMENTS],
    }
    return names[kind]()
