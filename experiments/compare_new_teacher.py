"""The full benchmark for teachers of your own, beside released results or Random.

python experiments/compare_new_teacher.py --teachers mine:Teacher,random --tier lite --results results
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("compare_new_teacher")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT))
