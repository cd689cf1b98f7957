"""Who needs torch pays for it, and nobody else."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = "{'torch', 'stable_baselines3', 'sklearn', 'pygame', 'matplotlib'}"


@pytest.mark.parametrize(
    "script",
    [
        "import tma_ray.campaign.actors",
        "import tma_ray.campaign.execution",
        "from tma_ray.runs import *; effective_spec(Cell(student='ppo', teacher='random'), 0, Schedule())",
        "from tma_ray.runs import *\n"
        "InlineTeacher(effective_spec(Cell(student='ppo', teacher='random'), 0, Schedule())).exchange(None)",
        "from tma_ray.cli import main; main(['list'])",
    ],
)
def test_teachers_and_drivers_start_without_torch(script: str) -> None:
    check = f"{script}\nimport sys\nassert not {HEAVY} & set(sys.modules), {HEAVY} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", check], check=True)
