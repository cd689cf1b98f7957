"""The five challenges of Stump Tracks, read after a quarter of the budget.

python experiments/sample_efficiency.py --tier lite --results results
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("sample_efficiency")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT), EXPERIMENT.read_at)
