"""Run all benchmarks that need no trained results, and gather their JSON in one folder.

    python benchmarks/run_all.py --output build/benchmarks
    python benchmarks/run_all.py --smallest --scripts acting teacher_cost

Excludes learning curves (`learning.py`, `locomotion.py`, `precision.py`), which are campaigns of hours, and
`interval_coverage.py` and `familywise_error.py`, which print tables of the documentation.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

SMALLEST = {
    "env_step": "--steps 20 --repeats 1 --environments stump_tracks --bodies classic_bipedal",
    "acting": "--calls 10 --repeats 1",
    "student_training": "--precisions medium --steps 100 --repeats 1",
    "evaluation": "--training-steps 100 --repeats 1",
    "vector_envs": "--numbers 2 --steps 40 --repeats 1",
    "teacher_cost": "--episodes 8",
    "actor_overhead": "--students ppo --steps 200 --episodes 5 --repeats 1",
    "curriculum": "--exchanges 10 --turns 1",
    "checkpoints": "--transitions 100 --more 10",
    "scheduler": "--runs 2 --processes 1",
    "cluster_scale": "--runs 4",
    "analysis_scale": "--root build/smallest_benchmark --seeds 1 --steps 500000",
    "analysis_commands": "--root build/smallest_separate --seeds 1 --steps 500000",
}
"""Scripts in order, with arguments for a run of seconds, whose results are meaningless."""


def main() -> None:
    """Run every script in a separate process."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/benchmarks"), help="folder (%(default)s)")
    parser.add_argument(
        "--scripts", nargs="+", choices=SMALLEST, default=list(SMALLEST), help="(default: all)"
    )
    parser.add_argument("--smallest", action="store_true", help="only check that each script runs to its end")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for name in options.scripts:
        print(f"== {name}", flush=True)
        script = Path(__file__).parent / f"{name}.py"
        arguments = SMALLEST[name].split() if options.smallest else []
        output = str(options.output / f"{name}.json")
        subprocess.run([sys.executable, str(script), *arguments, "--output", output], check=True)


if __name__ == "__main__":
    main()
