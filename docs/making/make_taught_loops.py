"""Train the examples of teachers in other training loops, and plot the share of mastered tasks.

    python docs/making/make_taught_loops.py --seeds 5

Trains the runs that are missing in benchmarks/measured/taught_loops.csv, up to two minutes of an idle core
each, and adds them to the file. `--seeds 0` only draws the picture.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

ROOT = Path(__file__).parents[2]
TABLE = ROOT / "benchmarks" / "measured" / "taught_loops.csv"
PICTURE = ROOT / "docs" / "images" / "taught_loops.png"

TITLES = {"sb3_pendulum": "pendulum", "sb3_hopper": "hopper"}
TEACHERS = {
    "sb3_pendulum": {"random": "Random", "alp_gmm:fit_every=25": "ALP-GMM"},
    "sb3_hopper": {"random": "Random", "alp_gmm:fit_every=50": "ALP-GMM"},
}


def train(example: str, teacher: str, seed: int) -> float:
    """Train an example, and return the share of test tasks that its student masters."""
    sys.path.append(str(ROOT / "examples"))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # examples save their curricula in the working directory
        share: float = importlib.import_module(example).train(teacher, seed)
        os.chdir(ROOT)
    return share


def draw(axes: Axes, example: str, rows: pd.DataFrame) -> None:
    """Plot the results of each seed as a line between teachers, and the means."""
    shares = 100 * rows.pivot_table("mastered", "seed", "teacher")[list(TEACHERS[example])]
    axes.plot(range(shares.shape[1]), shares.T, color="#9aa5b1", marker="o", linewidth=1)
    axes.plot(range(shares.shape[1]), shares.mean(), color="#1b6f9c", marker="_", markersize=30, linestyle="")
    axes.set_xticks(range(shares.shape[1]), list(TEACHERS[example].values()))
    axes.set(title=f"{TITLES[example]}, {len(shares)} seeds", xlim=(-0.5, 1.5), ylim=(0, 100))
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Train the runs that are missing in the table, and plot it."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--seeds", type=int, default=0, help="seeds of each teacher")
    options = parser.parse_args()
    rows = pd.read_csv(TABLE)
    done = set(zip(rows["example"], rows["teacher"], rows["seed"], strict=True))
    for seed in range(options.seeds):
        for example, teachers in TEACHERS.items():
            for teacher in teachers:
                if (example, teacher, seed) not in done:
                    rows.loc[len(rows)] = example, teacher, seed, train(example, teacher, seed)
                    rows.to_csv(TABLE, index=False)
    figure, panels = plt.subplots(1, len(TITLES), figsize=(6, 3), sharey=True)
    for axes, (example, its_rows) in zip(panels, rows.groupby("example", sort=False), strict=True):
        draw(axes, str(example), its_rows)
    panels[0].set_ylabel("mastered test tasks (%)")
    figure.tight_layout()
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
