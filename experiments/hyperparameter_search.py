"""The search for every teacher's hyper-parameters, at the knowledge of its authors' paper.

python experiments/hyperparameter_search.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "hyperparameter_search", *sys.argv[1:]]))
