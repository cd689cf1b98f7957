"""Stump Tracks: the original space and the paper's five challenges, at three levels of expert knowledge.

python experiments/stump_tracks_challenges.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "stump_tracks_challenges", *sys.argv[1:]]))
