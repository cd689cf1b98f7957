"""Draw the rooms of the code on their floors: ``docs/images/rooms.svg``."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Final, NamedTuple

PICTURE: Final = Path(__file__).parents[1] / "images" / "rooms.svg"

WIDTH, HEIGHT, GAP = 800, 46, 8
"""Width of a floor, its height, and the distance between boxes, in pixels."""


class Room(NamedTuple):
    """Packages that belong together, and what they hold."""

    title: str
    packages: tuple[str, ...]
    holds: str


FLOORS: Final = (
    (Room("Command line", ("tma_ray.cli",), "commands; experiments are scripts of a few lines"),),
    (
        Room(
            "Analysis", ("analysis",), "reads results: measures, comparisons, claims, charts, pages, releases"
        ),
    ),
    (Room("Campaigns", ("tma_ray.campaign",), "plans, scheduler, executors: the only user of Ray"),),
    (
        Room(
            "Viewing, export, curriculum",
            ("tma_ray.viewing", "tma_ray.export", "tma_ray.playground", "tma_ray.curriculum"),
            "videos, ONNX, worlds in the browser; teachers in others' loops",
        ),
    ),
    (Room("Runs", ("tma_ray.runs", "tma_ray.testing"), "one run without Ray; simulated students"),),
    (Room("Benchmark", ("tma_ray.benchmark",), "challenges, test sets, the paper's numbers: data"),),
    (
        Room("Environments", ("tma_ray.envs",), "rules, frames"),
        Room("Teachers", ("tma_ray.teachers",), "one file each"),
        Room("Students", ("tma_ray.students",), "PPO, SAC, cohorts"),
        Room("Results", ("tma_ray.results",), "tables, storage"),
    ),
    (
        Room(
            "Physics",
            ("tma_ray.physics", "tma_ray.embodiments", "tma_ray.terrain"),
            "kernels and engines; bodies and terrain as data",
        ),
    ),
    (Room("Tasks", ("tma_ray.tasks",), "types that teachers, environments and runs share"),),
    (
        Room("Components", ("tma_ray.components",), "registries, settings, plug-ins"),
        Room("Console", ("tma_ray.console",), "command lines, tables, exit codes"),
    ),
    (Room("Support", ("tma_ray.support",), "validation, decoding, compilation, interrupts"),),
)
"""The twelve rooms: each imports only from floors below it."""


def picture() -> str:
    """Return the drawing."""
    boxes = []
    for level, floor in enumerate(FLOORS):
        width = (WIDTH - GAP * (len(floor) - 1)) / len(floor)
        for place, room in enumerate(floor):
            left, top = place * (width + GAP), level * (HEIGHT + GAP)
            middle = left + width / 2
            boxes.append(
                f'<rect x="{left:g}" y="{top}" width="{width:g}" height="{HEIGHT}" rx="4" fill="#eef1f8" '
                f'stroke="#3f51b5"/>\n<text x="{middle:g}" y="{top + 19}" font-weight="bold">{room.title}'
                f'</text>\n<text x="{middle:g}" y="{top + 36}">{escape(room.holds)}</text>'
            )
    height = len(FLOORS) * (HEIGHT + GAP) - GAP
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-1 -1 {WIDTH + 2} {height + 2}" '
        'font-family="sans-serif" font-size="13" text-anchor="middle" fill="#22262b">\n'
        + "\n".join(boxes)
        + "\n</svg>\n"
    )


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
