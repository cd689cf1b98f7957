"""The search for every teacher's hyper-parameters, at the knowledge of its authors' paper.

python experiments/hyperparameter_search.py --tier lite --results results
"""

from analysis.commands.search import show_search
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("hyperparameter_search")

if __name__ == "__main__":
    show_search(run_experiment(EXPERIMENT))
