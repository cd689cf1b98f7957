"""Parkour: 48 seeds, 16 each for a walker, a fish and a climber, at low expert knowledge.

python experiments/parkour.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "parkour", *sys.argv[1:]]))
