"""Runs all benchmarks and gathers their JSON under one folder.

python benchmarks/run_all.py --output build/benchmarks
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

SCRIPTS = (
    "env_step",
    "acting",
    "student_training",
    "evaluation",
    "vector_envs",
    "teacher_cost",
    "actor_overhead",
    "checkpoints",
    "scheduler",
    "analysis_scale",
)


def main() -> None:
    """Runs each script in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("build/benchmarks"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    for name in SCRIPTS:
        print(f"== {name}", flush=True)
        script = Path(__file__).parent / f"{name}.py"
        subprocess.run([sys.executable, str(script), "--output", str(folder / f"{name}.json")], check=True)


if __name__ == "__main__":
    main()
