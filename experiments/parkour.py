"""Parkour: 48 seeds, 16 each for a walker, a fish and a climber, at low expert knowledge.

python experiments/parkour.py --tier lite --results results
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("parkour")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT))
