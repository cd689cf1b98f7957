"""Stump Tracks: the original space and the paper's five challenges, at three levels of expert knowledge.

python experiments/stump_tracks_challenges.py --tier lite --results results
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("stump_tracks_challenges")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT))
