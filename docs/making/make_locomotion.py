"""Plot learning curves in Parkour and animate the best runs, from results of benchmarks/locomotion.py.

python docs/making/make_locomotion.py build/locomotion --output docs/images
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

from tma_ray.results import Results, Table
from tma_ray.viewing.rendering import EpisodeSettings, render

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))
from locomotion import BODIES, random_return

WANTED = 150.0
"""Mean return of a body that has learned to move, except climbers."""

FILM_STEPS, STEPS_PER_FRAME = 450, 5
SEED_COLOURS = ("#1b6f9c", "#d1603d", "#5d8a4a")


def evaluations(roots: list[Path]) -> pd.DataFrame:
    """Return the mean return of every evaluation: root, run_id, challenge, seed, step, episodic_return."""
    tables = []
    for root in roots:
        results = Results.open(root)
        cells = results.table(Table.CELLS).to_pandas()[["run_id", "challenge", "seed"]]
        rows = results.table(Table.EVALUATIONS, columns=["run_id", "step", "episodic_return"]).to_pandas()
        means = rows.groupby(["run_id", "step"], observed=True).episodic_return.mean().reset_index()
        tables.append(means.merge(cells, on="run_id").assign(root=str(root)))
    return pd.concat(tables, ignore_index=True)


def draw(axes: Axes, challenge: str, rows: pd.DataFrame) -> None:
    """Plot the learning curve of every seed on a challenge, and the mean return of random actions."""
    body = BODIES[challenge]
    for colour, (seed, curve) in zip(SEED_COLOURS, rows.groupby("seed"), strict=False):
        curve = curve.sort_values("step")
        axes.plot(curve.step / 1e6, curve.episodic_return, color=colour, label=f"seed {seed}")
    axes.axhline(random_return(challenge, body), color="#777777", linestyle=":", label="random actions")
    if challenge != "easy_climbing":
        axes.axhline(WANTED, color="#777777", linestyle="--", label=f"a return of {WANTED:.0f}")
    axes.set_title(f"{body.replace('_', ' ')}, {challenge.removeprefix('easy_')}", fontsize=10)
    axes.set_xlabel("million environment steps")
    axes.spines[["top", "right"]].set_visible(False)


def film(challenge: str, rows: pd.DataFrame, folder: Path) -> Path:
    """Write an animation of the run with the highest return at its last evaluation; return the file."""
    last = rows[rows.step == rows.step.max()]
    best = last.loc[last.episodic_return.idxmax()]
    path = folder / f"learned_{challenge.removeprefix('easy_')}.gif"
    render(EpisodeSettings(best.run_id, best.root, steps=FILM_STEPS, every=STEPS_PER_FRAME), path)
    return path


def main() -> None:
    """Write locomotion.png and an animation of each challenge."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument(
        "roots", type=Path, nargs="+", help="finished results roots, each challenge in one only"
    )
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    rows = evaluations(options.roots)
    found = [challenge for challenge in BODIES if challenge in set(rows.challenge)]
    figure, panels = plt.subplots(1, len(found), figsize=(3.6 * len(found), 3.2), squeeze=False)
    for axes, challenge in zip(panels[0], found, strict=True):
        draw(axes, challenge, rows[rows.challenge == challenge])
        film(challenge, rows[rows.challenge == challenge], options.output)
    panels[0, 0].set_ylabel("mean return on 20 test tasks")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="lower center", ncols=5, frameon=False)
    figure.tight_layout(rect=(0, 0.08, 1, 1))
    figure.savefig(options.output / "locomotion.png", dpi=130)


if __name__ == "__main__":
    main()
