"""Draw the pictures of the README from a finished quickstart.

python docs/making/make_pictures.py results --output docs/images
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

import matplotlib.image
import numpy as np

from tma_ray.envs import make_environment
from tma_ray.results import Results, Table, policy_folder
from tma_ray.students import load_policy

TASK = np.array([0.5, 3.0], dtype=np.float32)
STEPS_BETWEEN_FRAMES = 250
FRAMES = 3


def best_run(results: Results) -> tuple[str, str]:
    """Return the run with the highest mean return at its last evaluation: run id and student."""
    rows = results.table(Table.EVALUATIONS, columns=["run_id", "step", "episodic_return"]).to_pandas()
    last = rows[rows.step == rows.step.max()]
    run_id = str(last.groupby("run_id", observed=True).episodic_return.mean().idxmax())
    return run_id, next(m.run.student for m in results.runs() if m.run.run_id == run_id)


def walk(root: Path) -> np.ndarray:
    """Return frames of an episode of the best policy side by side (height, width, 3)."""
    run_id, student = best_run(Results.open(root))
    policy = load_policy(student, root / policy_folder(run_id))
    environment = make_environment("stump_tracks", render_mode="rgb_array")
    observation, _ = environment.reset(seed=3, options={"task": TASK})
    frames = []
    while len(frames) < FRAMES:
        for _ in range(STEPS_BETWEEN_FRAMES):
            observation, _, terminated, truncated, _ = environment.step(policy(observation[None])[0])
            if terminated or truncated:
                raise SystemExit(f"the best policy, {run_id}, ends after {len(frames)} frames; train longer")
        frames.append(environment.render())
    return np.concatenate(frames, axis=1)


def main() -> None:
    """Write walker.png and curriculum.png."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("root", type=Path, help="results root of a finished quickstart with a report")
    parser.add_argument("--output", type=Path, default=Path("docs/images"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    matplotlib.image.imsave(options.output / "walker.png", walk(options.root))
    shutil.copy(options.root / "report" / "comparison-1-curriculum.png", options.output / "curriculum.png")


if __name__ == "__main__":
    main()
