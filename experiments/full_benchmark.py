"""Everything that is compared: Stump Tracks, its challenges and Parkour, for all teachers.

python experiments/full_benchmark.py --tier lite --results results
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("full_benchmark")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT))
