"""The five challenges of Stump Tracks, read after a quarter of the budget.

python experiments/sample_efficiency.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "sample_efficiency", *sys.argv[1:]]))
