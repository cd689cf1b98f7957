"""Draws every body at its start in Stump Tracks, as docs/images/bodies.png.

python docs/make_bodies.py --output docs/images/bodies.png
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from tma_ray.embodiments import embodiment_names
from tma_ray.envs import make_environment

TASK = np.array([1.0, 2.0], dtype=np.float32)
COLUMNS = 3


def standing(body: str) -> np.ndarray:
    """Returns the first frame of an episode (height, width, 3)."""
    environment = make_environment("stump_tracks", embodiment=body, render_mode="rgb_array")
    environment.reset(seed=0, options={"task": TASK})
    return environment.render()


def main() -> None:
    """Writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", nargs="*", default=embodiment_names(), metavar="NAME")
    parser.add_argument("--output", type=Path, default=Path("docs/images/bodies.png"))
    options = parser.parse_args()
    rows = -(-len(options.bodies) // COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(4 * COLUMNS, 3 * rows), layout="compressed", squeeze=False
    )
    for axis in axes.flat:
        axis.axis("off")
    for axis, body in zip(axes.flat, options.bodies, strict=False):
        axis.imshow(standing(body))
        axis.set_title(body.replace("_", " "))
    figure.savefig(options.output, dpi=110)


if __name__ == "__main__":
    main()
