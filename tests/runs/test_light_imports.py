"""Who needs torch pays for it, and nobody else."""

from __future__ import annotations

import subprocess
import sys

HEAVY = "{'torch', 'stable_baselines3', 'sklearn', 'pygame', 'matplotlib'}"

STEPS = (
    "import tma_ray.campaign.actors",
    "import tma_ray.campaign.execution",
    "from tma_ray.runs import *",
    "spec = effective_spec(Cell(student='ppo', teacher='alp_gmm'), 0, Schedule())",
    "InlineTeacher(spec).exchange(None)",
    "from tma_ray.cli import main; main(['list'])",
)
"""What drivers and teachers do, one after the other in one process."""


def test_teachers_and_drivers_start_without_torch() -> None:
    check = f"import sys; loaded = {HEAVY} & set(sys.modules); assert not loaded, (step, loaded)"
    script = "\n".join(f"step = {step!r}\n{step}\n{check}" for step in STEPS)
    subprocess.run([sys.executable, "-c", script], check=True)
