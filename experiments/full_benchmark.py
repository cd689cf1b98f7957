"""Everything that is compared: Stump Tracks, its challenges and Parkour, for all teachers.

python experiments/full_benchmark.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "full_benchmark", *sys.argv[1:]]))
