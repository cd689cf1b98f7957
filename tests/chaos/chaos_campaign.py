"""Campaign of the chaos tests: PPO under an adaptive teacher, and SAC under Random."""

from pathlib import Path

from small_runs import STUDENTS

from tma_ray.campaign import Campaign
from tma_ray.runs import Cell, Schedule

TESTS = Path(__file__).with_name("three_corridors.csv")

CAMPAIGN = Campaign(
    "chaos",
    tuple(
        Cell(
            environment="saboteur:Corridor",
            embodiment="",
            student=student,
            teacher=teacher,
            teacher_hyperparameters=hyperparameters,
            student_hyperparameters=STUDENTS[student],
            test_set=str(TESTS),
        )
        for student, teacher, hyperparameters in (
            ("ppo", "saboteur:Teacher", {"fit_every": 20}),
            ("sac", "random", {}),
        )
    ),
    seeds=(0,),
    schedule=Schedule(6_000, 1_500, probe_interval=1_500, probe_size=5, training_window=1_500),
)

if __name__ == "__main__":
    CAMPAIGN.main()
