"""Draw the pictures of a release for the leaderboard: differences, film strips and animations.

python docs/making/make_leaderboard_pictures.py lite-2 --output docs/images/leaderboard

``--differences`` draws the differences alone. Curricula show each teacher's first seed, which stays the same
while a release grows.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from analysis.baselines import find_baseline
from analysis.charts.base import PAGE_WIDTH
from analysis.charts.curricula import sheets
from analysis.charts.paper.drawing import draw
from analysis.charts.paper.style import svg
from analysis.commands.leaderboards import difference_charts
from analysis.data.curricula import curricula_of_runs, task_axes
from analysis.data.frames import Frames
from analysis.figures import Shot, animation, film_strip
from analysis.names import label, teacher_order
from tma_ray.tasks import KnowledgeLevel

FRAMES, DPI, COLOURS = 9, 90, 64


def main() -> None:
    """Write differences as NAME-1.svg, film strips as NAME-CHALLENGE.png, and animations as GIF files."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("release", help="name, folder or address of a release with curricula")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER", help="made if missing")
    parser.add_argument("--differences", action="store_true", help="draw the differences to Random alone")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for name, chart in difference_charts(options.release):
        (options.output / name).write_text(f"{svg(draw(chart))}\n", encoding="utf-8")
    if options.differences:
        return
    baseline = find_baseline(options.release)
    frames = baseline.frames()
    for challenge, runs in first_runs(frames):
        _draw(frames, runs, options.output / f"{baseline.manifest.name}-{challenge}")
        print(challenge, *runs["teacher"])


def first_runs(frames: Frames) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield the challenges of Stump Tracks, each with one run per teacher.

    The run has the highest level of expert knowledge, the first body and the first seed.
    """
    cells = frames.cells
    done = cells[(cells["status"] == "done") & (cells["environment"] == "stump_tracks")]
    ranks = done["expert_knowledge"].map(lambda level: KnowledgeLevel(level).rank)
    order = ["rank", "embodiment", "seed"]
    ordered = done.assign(rank=ranks).sort_values(order, ascending=[False, True, True])
    ordered = ordered.drop_duplicates(["challenge", "teacher"])
    for challenge, runs in ordered.groupby("challenge"):
        yield str(challenge), runs.sort_values("teacher", key=lambda names: names.map(teacher_order))


def _draw(frames: Frames, runs: pd.DataFrame, path: Path) -> None:
    rows = [run for _, run in runs.iterrows()]
    curricula = curricula_of_runs(frames, rows)
    teachers = [str(run["teacher"]) for run in rows]
    shots = [Shot(label(name), name, each) for name, each in zip(teachers, curricula, strict=True)]
    plane: Any = tuple(task_axes(runs)[:2])
    figure = film_strip(shots, plane, width=PAGE_WIDTH)
    figure.savefig(path.with_suffix(".png"), dpi=DPI)
    with Image.open(path.with_suffix(".png")) as picture:
        smaller = picture.convert("RGB").quantize(COLOURS)
    smaller.save(path.with_suffix(".png"), optimize=True)
    for number, sheet in enumerate(sheets(shots), start=1):
        path.with_name(f"{path.name}-{number}.gif").write_bytes(animation(sheet, plane, FRAMES))


if __name__ == "__main__":
    main()
