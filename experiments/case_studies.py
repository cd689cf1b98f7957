"""The paper's case studies: climbing, expert knowledge, what ADR needs, students that forget.

python experiments/case_studies.py --tier lite --results results
"""

from analysis.commands.ranking import show_ranking
from tma_ray.benchmark import find_experiment
from tma_ray.campaign import run_experiment

EXPERIMENT = find_experiment("case_studies")

if __name__ == "__main__":
    show_ranking(run_experiment(EXPERIMENT))
