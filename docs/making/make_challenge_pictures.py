"""Draw worlds of Stump Tracks, and a picture of each challenge.

python docs/making/make_challenge_pictures.py --output docs/images
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from make_bodies import draw as draw_body
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from tma_ray.benchmark import STUMP_TRACKS_CHALLENGES, find_challenge, load_test_set
from tma_ray.embodiments import load_embodiment
from tma_ray.envs import make_environment
from tma_ray.runs import Schedule
from tma_ray.tasks import ShuffledSpace
from tma_ray.terrain.stump_tracks import stump_tracks

ORIGINAL = find_challenge("stump_tracks", "original").task_space
TESTS = load_test_set("stump_tracks").tasks
INK, SPACE, EASY, HARD, WALL = "#22262b", "#dfe6f5", "#5aa469", "#c0504d", "#5662b2"
SEED = 3


def height_axis(axis: Axes, low: float, high: float) -> None:
    """Set the limits and labels of axes over stump heights from `low` to `high` and gaps up to 6 m."""
    axis.set(xlim=(low - 0.2, high + 0.2), ylim=(-0.3, 6.3))
    axis.set(xlabel="mean stump height (terrain steps)", ylabel="gap between stumps (m)")
    axis.spines[["top", "right"]].set_visible(False)


def box(axis: Axes, low: float, high: float, colour: str, **look: object) -> None:
    """Draw the box of tasks with stump heights from `low` to `high`."""
    axis.add_patch(Rectangle((low, 0), high - low, 6, facecolor=colour, edgecolor="none", **look))


def tests(axis: Axes) -> None:
    """Draw the test tasks as dots."""
    axis.scatter(*TESTS.T, s=7, color=INK, zorder=3, linewidth=0)


def original() -> Figure:
    """Return a figure of the original task space with the test tasks and the easy task."""
    figure, axis = plt.subplots(figsize=(4.4, 3.1), layout="constrained")
    box(axis, 0, 3, SPACE)
    tests(axis)
    axis.scatter(0, 6, s=90, marker="*", color=EASY, zorder=4, clip_on=False)
    axis.annotate("easy task", (0, 6), (0.18, 5.55), color=EASY, fontweight="bold")
    height_axis(axis, 0, 3)
    return figure


def mostly_unfeasible() -> Figure:
    """Return a figure of the task space whose upper two thirds (heights up to 9) no body masters."""
    figure, axis = plt.subplots(figsize=(6.4, 2.9), layout="constrained")
    box(axis, 0, 3, SPACE)
    box(axis, 3, 9, HARD, alpha=0.25)
    tests(axis)
    axis.text(6, 3, "stumps too high for the body", ha="center", color=HARD, fontweight="bold")
    height_axis(axis, 0, 9)
    return figure


def mostly_trivial() -> Figure:
    """Return a figure of the task space whose lower half (heights from -3) is flat ground."""
    figure, axis = plt.subplots(figsize=(6.0, 2.9), layout="constrained")
    box(axis, -3, 0, EASY, alpha=0.3)
    box(axis, 0, 3, SPACE)
    tests(axis)
    axis.text(-1.5, 3, "as good as flat", ha="center", color="#2e6b3c", fontweight="bold")
    height_axis(axis, -3, 3)
    return figure


def forgetting_student() -> Figure:
    """Return a time line of a run with evaluations and resets of the student."""
    schedule = Schedule()
    million = schedule.steps / 1e6
    resets = [share * million for share in find_challenge("stump_tracks", "forgetting_student").resets]
    figure, axis = plt.subplots(figsize=(6.4, 1.5), layout="constrained")
    for first, last in zip([0, *resets], [*resets, million], strict=True):
        axis.add_patch(
            Rectangle((first, 0), last - first, 1, facecolor=SPACE, edgecolor="white", linewidth=3)
        )
        axis.text((first + last) / 2, 0.5, "learns", ha="center", va="center")
    for reset in resets:
        axis.annotate(
            f"forgets at {reset:g} M", (reset, 1), (reset, 1.5), ha="center", color=HARD, fontweight="bold",
            arrowprops={"arrowstyle": "->", "color": HARD},
        )  # fmt: skip
    marks = np.arange(0, million + 0.1, schedule.evaluation_interval / 1e6)
    axis.scatter(marks, np.full_like(marks, -0.2), s=5, color=INK)
    axis.set(xlim=(-0.2, million + 0.2), ylim=(-0.45, 1.9), yticks=[])
    axis.set_xlabel("environment steps (millions); a dot is an evaluation")
    axis.spines[["top", "right", "left"]].set_visible(False)
    return figure


def rugged_difficulty() -> Figure:
    """Return maps of difficulty over the world's task space and over the shuffled one of the teacher."""
    heights, gaps = (np.linspace(low, high, 161)[:-1] + 1e-3 for low, high in ((0, 3), (0, 6)))
    tasks = np.stack(np.meshgrid(heights, gaps), axis=-1).astype(np.float32)
    shuffled = ShuffledSpace.shuffle(ORIGINAL, np.random.default_rng(SEED))
    figure, axes = plt.subplots(1, 2, figsize=(7.0, 3.0), layout="constrained", sharey=True)
    pictures = {"the world": tasks, "what the teacher sees": shuffled.to_world(tasks)}
    for axis, (title, there) in zip(axes, pictures.items(), strict=True):
        difficulty = there[..., 0] / 3 * (1 - 0.6 * there[..., 1] / 6)
        image = axis.imshow(difficulty, origin="lower", extent=(0, 3, 0, 6), aspect="auto", cmap="viridis")
        height_axis(axis, 0, 3)
        axis.set_title(title)
    axes[1].set_ylabel("")
    figure.colorbar(image, ax=axes, label="difficulty (sketch)", ticks=[])
    return figure


def diverse_students() -> Figure:
    """Return a figure of the pooled bodies, with the students that train on them."""
    (matrix,) = (each for each in STUMP_TRACKS_CHALLENGES if each.name == "diverse_students")
    figure, axes = plt.subplots(1, 2, figsize=(5.4, 3.7), layout="constrained")
    for axis, name in zip(axes, matrix.embodiments, strict=True):
        draw_body(axis, load_embodiment(name))
        axis.set_xlabel(" and ".join(student.upper() for student in matrix.students))
    return figure


def worlds() -> Figure:
    """Return a figure of the ground of nine tasks."""
    figure, axes = plt.subplots(3, 3, figsize=(9, 2.7), layout="constrained", sharex=True, sharey=True)
    for row, height in zip(axes, (0.0, 1.5, 3.0), strict=True):
        for axis, gap in zip(row, (0.5, 3.0, 6.0), strict=True):
            terrain = stump_tracks(np.array([height, gap], np.float32), np.random.default_rng(SEED))
            line = np.vstack([terrain.surface[:, :2], terrain.surface[-1:, 2:]])
            floor = terrain.spawn[1]
            axis.fill_between(line[:, 0], line[:, 1] - floor, -1, color="#6b7f4f", linewidth=0)
            axis.set(xlim=(6, 24), ylim=(-0.4, 2.1), aspect="equal", yticks=[0, 1, 2])
            axis.set_title(f"height {height:g}, gap {gap:g} m", fontsize=9)
            axis.spines[["top", "right"]].set_visible(False)
    axes[2, 1].set_xlabel("x (m); the track ends at 93 m")
    axes[1, 0].set_ylabel("m")
    return figure


def lidars() -> np.ndarray:
    """Return a frame (height, width, 3) of the environment: the walker before stumps, with its lidars."""
    environment = make_environment("stump_tracks", render_mode="rgb_array")
    environment.reset(seed=SEED, options={"task": [1.5, 1.0]})
    frame = np.asarray(environment.render())
    environment.close()
    return frame


PICTURES = {
    "challenge_original": original,
    "challenge_mostly_unfeasible": mostly_unfeasible,
    "challenge_mostly_trivial": mostly_trivial,
    "challenge_forgetting_student": forgetting_student,
    "challenge_rugged_difficulty": rugged_difficulty,
    "challenge_diverse_students": diverse_students,
    "stump_tracks": worlds,
}


def main() -> None:
    """Write the PNG files of `PICTURES`, and stump_tracks_start.png."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    plt.rcParams.update({"font.size": 8.5, "axes.titlesize": 9.5, "savefig.dpi": 130})
    for name, make in PICTURES.items():
        figure = make()
        figure.savefig(options.output / f"{name}.png")
        plt.close(figure)
    plt.imsave(options.output / "stump_tracks_start.png", lidars())


if __name__ == "__main__":
    main()
