"""The runs of the release lite-1, a stage after the other: core, levels, parkour, seeds.

nice -n 19 python experiments/lite_1.py --stage core --results lite --yes
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("lite_1")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT))
