"""Draw all bodies in their initial poses, to one scale: ``docs/images/bodies.png``.

python docs/making/make_bodies.py --output docs/images/bodies.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from numpy.typing import NDArray

from tma_ray.embodiments import BodyType, Embodiment, embodiment_names, load_embodiment
from tma_ray.physics.base import settings_for
from tma_ray.physics.chipmunk import settled
from tma_ray.physics.rules import BodyArrays

COLUMNS = 5
WIDTH, HEIGHT, MARGIN = 4.2, 6.2, 0.35
"""Width and height of a cell, and height of the soil in it, in m."""

HEAD, LIMB, OUTLINE, GRIP = "#5662b2", "#8a94d8", "#2a3060", "#f0b429"
SKY, WATER, SOIL, SOIL_EDGE = "#e3edf5", "#a9d3e8", "#687a5c", "#42543c"

ORDER = list(BodyType)
Floats = NDArray[np.float64]


def placed(position: Floats, angle: float, points: Floats) -> Floats:
    """Return `points` (n, 2) in world coordinates, given `position` and `angle` (rad) of their frame."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.asarray(position + points @ np.array([[cosine, sine], [-sine, cosine]]))


def draw(axis: Axes, body: Embodiment) -> None:
    """Draw a body in its initial pose: on the ground, at the ceiling or in the water."""
    pose = settled(body, settings_for(body))
    places = range(len(body.parts))
    outlines = [placed(pose.position[i], pose.angle[i], body.parts[i].shape.points) for i in places]
    corners = np.concatenate(outlines)
    left = (corners[:, 0].min() + corners[:, 0].max() - WIDTH) / 2
    draw_world(axis, body, left)
    lift = HEIGHT - 2 * MARGIN - grips(body, pose)[:, 1].max() if body.grip_sensors else 0.0
    up = np.array([0.0, lift])
    for i in sorted(places, key=lambda part: (part == body.head, -part)):
        colour = to_rgba(HEAD if i == body.head else LIMB, 0.75)  # shows limbs behind the trunk
        axis.add_patch(Polygon(outlines[i] + up, facecolor=colour, edgecolor=OUTLINE, linewidth=0.9))
    for joint in body.joints:
        part = body.part_index(joint.part_b)
        anchor = np.array([body.parts[part].local(joint.anchors[1])])
        x, y = placed(pose.position[part], pose.angle[part], anchor)[0] + up
        if joint.outside_parts:  # such as a neck
            neck = np.array([(x, y), pose.position[body.part_index(joint.part_a)] + up])
            axis.plot(*neck.T, color=OUTLINE, linewidth=3, zorder=0.9, solid_capstyle="butt")
        face = "white" if joint.passive else OUTLINE
        axis.add_patch(Circle((x, y), 0.045, facecolor=face, edgecolor=OUTLINE, linewidth=0.7))
    for sensor, centre in zip(body.grip_sensors, grips(body, pose), strict=True):
        axis.add_patch(Circle(centre + up, sensor.radius, facecolor=GRIP, edgecolor=OUTLINE, linewidth=0.7))
    axis.set_title(f"{body.name.replace('_', ' ')}\n{caption(body)}", fontsize=8)


def grips(body: Embodiment, pose: BodyArrays) -> Floats:
    """Return the centres of the grip sensors (g, 2), in m above the ground."""
    centres = []
    for sensor in body.grip_sensors:
        part = body.part_index(sensor.part)
        local = np.array([body.parts[part].local(sensor.position)])
        centres.append(placed(pose.position[part], pose.angle[part], local)[0])
    return np.array(centres).reshape(-1, 2)


def draw_world(axis: Axes, body: Embodiment, left: float) -> None:
    """Draw the ground, the water of swimmers, and the ceiling of climbers."""
    axis.set(xlim=(left, left + WIDTH), ylim=(-MARGIN, HEIGHT - MARGIN), aspect="equal", xticks=[], yticks=[])
    axis.set_facecolor(WATER if body.steps_survivable_under_water is None else SKY)
    axis.add_patch(Rectangle((left, -MARGIN), WIDTH, MARGIN, facecolor=SOIL, edgecolor=SOIL_EDGE))
    if body.grip_sensors:
        axis.add_patch(
            Rectangle((left, HEIGHT - 2 * MARGIN), WIDTH, MARGIN, facecolor=SOIL, edgecolor=SOIL_EDGE)
        )
    axis.plot([left + WIDTH - 1.25, left + WIDTH - 0.25], [-0.2, -0.2], color="white", linewidth=1.5)
    axis.text(left + WIDTH - 1.35, -0.2, "1 m", color="white", fontsize=7, ha="right", va="center")


def caption(body: Embodiment) -> str:
    """Return a caption with type, mass, motors and grips of a body."""
    grip = f", {len(body.grip_sensors)} grips" if body.grip_sensors else ""
    mass = sum(piece.mass for piece in (*body.parts, *body.grip_sensors))
    return f"{body.body_type}, {mass:.1f} kg, {len(body.motors)} motors{grip}"


def main() -> None:
    """Write the picture of all bodies."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--bodies", nargs="*", default=embodiment_names(), metavar="NAME")
    parser.add_argument("--output", type=Path, default=Path("docs/images/bodies.png"))
    options = parser.parse_args()
    bodies = sorted(map(load_embodiment, options.bodies), key=lambda body: ORDER.index(body.body_type))
    rows = -(-len(bodies) // COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(2.4 * COLUMNS, 3.6 * rows), layout="constrained", squeeze=False
    )
    for axis, body in zip(axes.flat, bodies, strict=False):
        draw(axis, body)
    for axis in axes.flat[len(bodies) :]:
        axis.axis("off")
    dot = {"linestyle": "", "marker": "o", "markeredgecolor": OUTLINE}
    legend = [
        Patch(facecolor=HEAD, edgecolor=OUTLINE, label="head"),
        Patch(facecolor=LIMB, edgecolor=OUTLINE, label="other part"),
        Line2D([], [], markerfacecolor=OUTLINE, markersize=6, label="joint with a motor", **dot),
        Line2D([], [], markerfacecolor="white", markersize=6, label="joint without a motor", **dot),
        Line2D([], [], markerfacecolor=GRIP, markersize=7, label="grip sensor", **dot),
        Patch(facecolor=WATER, label="in the water for as long as it likes"),
    ]
    axes.flat[-1].legend(handles=legend, loc="lower right", frameon=False, fontsize=9).set_in_layout(False)
    figure.savefig(options.output, dpi=110)


if __name__ == "__main__":
    main()
