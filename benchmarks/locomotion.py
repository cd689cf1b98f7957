"""Learning curves of walking, swimming and climbing: PPO under Random on the easy challenges of Parkour.

    python benchmarks/locomotion.py --seeds 3 --steps 2M --results build/locomotion

The classic bipedal walks on gentle dry ground, the fish swims in deep water, the climbing chimpanzee climbs
along a nearly flat ceiling. Prints the mean return of every evaluation on the 20 test tasks, and with the
last one the mean return of uniformly random actions.
"""

from __future__ import annotations

import numpy as np
from campaigns import main
from numpy.typing import NDArray
from scipy import stats

from tma_ray.benchmark import find_challenge, load_test_set
from tma_ray.campaign import Campaign
from tma_ray.envs import make_environment
from tma_ray.results import Results, Table
from tma_ray.runs import Cell, Schedule

Floats = NDArray[np.float64]

BODIES = {
    "easy_walking": "classic_bipedal",
    "easy_swimming": "fish",
    "easy_climbing": "climbing_chimpanzee",
}
"""Body of each challenge."""

CAMPAIGN = Campaign(
    name="locomotion",
    cells=tuple(Cell("parkour", challenge, body, "ppo", "random") for challenge, body in BODIES.items()),
    seeds=(0, 1, 2),
    schedule=Schedule(steps=2_000_000),
)


def random_return(challenge: str, body: str) -> float:
    """Return the mean return of uniformly random actions on the test tasks of a challenge."""
    environment = make_environment("parkour", embodiment=body)
    tasks, rng = load_test_set(find_challenge("parkour", challenge).test_set).tasks, np.random.default_rng(0)
    total = 0.0
    for index, task in enumerate(tasks):
        environment.reset(seed=index, options={"task": task})
        over = False
        while not over:
            action = rng.uniform(-1, 1, environment.action_space.shape).astype(np.float32)
            _, reward, terminated, truncated, _ = environment.step(action)
            total += float(reward)
            over = terminated or truncated
    return total / len(tasks)


def bootstrap(returns: Floats, resamples: int = 10_000) -> tuple[float, float]:
    """Return the 95 % percentile interval of the mean of `returns` (seeds, tasks).

    Seeds are drawn with replacement, and then tasks of each seed. With three seeds this interval is too
    narrow, as it cannot exceed their range, unlike Student's t interval, which is also printed.
    """
    rng, (seeds, tasks) = np.random.default_rng(0), returns.shape
    runs = rng.integers(seeds, size=(resamples, seeds, 1))
    drawn = returns[runs, rng.integers(tasks, size=(resamples, seeds, tasks))]
    low, high = np.percentile(drawn.mean(axis=(1, 2)), [2.5, 97.5])
    return float(low), float(high)


def summarise(root: str) -> None:
    """Print the learning curves of all challenges, and the final mean returns with 95 % intervals."""
    results = Results.open(root)
    cells = results.table(Table.CELLS).to_pandas()[["run_id", "challenge", "seed"]]
    rows = results.table(Table.EVALUATIONS).to_pandas().merge(cells, on="run_id")
    for challenge, body in BODIES.items():
        mine = rows[rows.challenge == challenge]
        if len(mine):
            curves = mine.pivot_table("episodic_return", "step", "seed", observed=True)
            last = curves.iloc[-1].to_numpy()
            ended = mine[mine.step == mine.step.max()].pivot_table("episodic_return", "seed", "task_index")
            low, high = bootstrap(ended.to_numpy())
            margin = stats.t.ppf(0.975, len(last) - 1) * stats.sem(last) if len(last) > 1 else np.nan
            print(f"\n{body}, {challenge}: mean return by seed\n{curves.round(1).to_string()}")
            print(
                f"last {last.mean():.1f} ± {margin:.1f} (95 %, t), [{low:.1f}, {high:.1f}] (bootstrap), "
                f"random {random_return(challenge, body):.1f}"
            )


if __name__ == "__main__":
    raise SystemExit(main(CAMPAIGN, str(__doc__), summarise))
