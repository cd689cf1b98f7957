"""Draw Parkour's terrain: effects of the network's inputs, examples of test tasks, their difficulty.

python docs/making/make_parkour_pictures.py --output docs/images
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from parkour_demands import demands, difficulty

from tma_ray.benchmark import find_challenge, load_test_set
from tma_ray.terrain import Terrain
from tma_ray.terrain.parkour import CPPN, TRACK_POINTS, parkour
from tma_ray.terrain.terrain import TERRAIN_STEP

NETWORK = CPPN.load()
MEDIUM = find_challenge("parkour", "original").task_space
LENGTH = (TRACK_POINTS - 1) * TERRAIN_STEP
BELOW, ABOVE = 20.0, 28.0
"""Extent of pictures below and above the ground at the start, in m."""

GROUND, CEILING, WATER, CREEPER = "#6b7f4f", "#8c8c94", "#4f8fd0", "#2f6b2f"
CLASSES = {"easy": "#5aa469", "medium": "#e0a83a", "hard": "#c0504d"}
BODIES = {"walking": "walker", "swimming": "swimmer", "climbing": "climber"}
INSIDE = 60
"""Number of tasks of a test set from the medium space, which come first."""


def world(task: np.ndarray) -> Terrain:
    """Return the world of a task (8,)."""
    return parkour(task, np.random.default_rng(0), cppn=NETWORK)


def draw(axis: Axes, terrain: Terrain, *, creepers: bool = True) -> None:
    """Draw a world with or without creepers."""
    bottom, top = terrain.spawn[1] - BELOW, terrain.spawn[1] + ABOVE
    lines = [np.vstack([line[:, :2], line[-1:, 2:]]) for line in (terrain.surface, terrain.ceiling)]
    axis.fill_between([0, LENGTH], bottom, terrain.water_y, color=WATER, alpha=0.45, lw=0)
    for left, low, right, high in terrain.creepers if creepers else ():
        axis.add_patch(Rectangle((left, low), right - left, high - low, color=CREEPER, lw=0))
    axis.fill_between(*lines[0].T, bottom, color=GROUND, lw=0)
    axis.fill_between(*lines[1].T, top, where=lines[1][:, 1] < top, color=CEILING, lw=0)
    axis.plot(*terrain.spawn, marker="v", color="black", markersize=4)
    axis.set(xlim=(0, LENGTH), ylim=(bottom, top), xticks=[], yticks=[], aspect="equal")


def inputs() -> plt.Figure:
    """Return a figure of terrains over single inputs, with the others at the centre of the medium space."""
    shares = np.linspace(-1, 1, 5)
    figure, axes = plt.subplots(4, len(shares), figsize=(15, 6.9), layout="constrained")
    for row, (name, reach) in enumerate((("theta_1", 1), ("theta_2", 1), ("theta_3", 1), ("theta_2", 0.2))):
        index = MEDIUM.names.index(name)
        for axis, share in zip(axes[row], shares, strict=True):
            task = MEDIUM.centre.astype(np.float32)
            task[3] = 0  # no water
            task[index] = share * reach if reach == 1 else task[index] + share * reach
            draw(axis, world(task), creepers=False)
            theta = ", ".join(f"{value:.2f}" for value in task[:3])
            axis.set_title(f"θ = ({theta})", fontsize=9)
        label = f"θ{index + 1} from -1 to 1" if reach == 1 else f"θ{index + 1}, medium space"
        axes[row, 0].set_ylabel(label, fontsize=9)
    return figure


def rated(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the tasks (100, 8) of a test set and their difficulties (100,)."""
    tasks = load_test_set(f"parkour_{name}").tasks
    return tasks, np.array([difficulty(demands(world(task), BODIES[name])) for task in tasks])


def class_of(ranks: np.ndarray) -> list[str]:
    """Return the difficulty classes of tasks, given their ranks by difficulty from 0 to 99."""
    return [list(CLASSES)[min(2, int(3 * (rank + 0.5) / 100))] for rank in ranks]


def examples() -> plt.Figure:
    """Return a figure of example test tasks, one row per body, from easy to hard."""
    figure, axes = plt.subplots(3, 4, figsize=(15, 6.2), layout="constrained")
    for row, name in zip(axes, BODIES, strict=True):
        tasks, values = rated(name)
        order = np.argsort(values)
        for axis, place in zip(row, (8, 40, 65, 95), strict=True):
            index = order[place]
            draw(axis, world(tasks[index]))
            origin = "in" if index < INSIDE else "out of"
            level = class_of(np.array([place]))[0]
            axis.set_title(
                f"{name}, {level}: {origin} the training space, δ = {tasks[index, -1]:g}", fontsize=9
            )
    return figure


def order_of_difficulty() -> plt.Figure:
    """Return a figure of the difficulty of all test tasks in rising order, coloured by class."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.2), layout="constrained", sharex=True)
    for axis, (name, body_type) in zip(axes, BODIES.items(), strict=True):
        tasks, values = rated(name)
        order = np.argsort(values)
        inside = order < INSIDE
        colours = np.array([CLASSES[level] for level in class_of(np.arange(len(order)))])
        for part, marker, label in ((inside, "o", "in the training space"), (~inside, "D", "out of it")):
            axis.scatter(
                np.flatnonzero(part), values[order][part], c=colours[part], s=16, marker=marker, label=label
            )
        demanded = [demands(world(tasks[index]), body_type) for index in order]
        for demand in demanded[0]:
            smooth = np.convolve([d[demand] for d in demanded], np.ones(9) / 9, mode="valid")
            axis.plot(np.arange(4, len(order) - 4), smooth, lw=1, alpha=0.7, label=demand)
        axis.set(title=name, xlabel="tasks in the order of difficulty", ylim=(0, 1.35))
        for level, centre in zip(CLASSES, (16.5, 50, 83.5), strict=True):
            axis.text(centre, 1.03, level, color=CLASSES[level], ha="center")
        axis.legend(fontsize=8, ncols=3, loc="upper left")
    axes[0].set_ylabel("difficulty (points), demands (lines, mean of 9 tasks)")
    return figure


def main() -> None:
    """Write parkour_inputs.png, parkour_test_sets.png and parkour_difficulty.png."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    pictures = {"inputs": inputs, "test_sets": examples, "difficulty": order_of_difficulty}
    for name, make in pictures.items():
        make().savefig(options.output / f"parkour_{name}.png", dpi=100)


if __name__ == "__main__":
    main()
