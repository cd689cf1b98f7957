"""The runs of the release long-1, first seeds first; its stages: parkour, stump_tracks, more_seeds.

nice -n 19 python experiments/long_1.py --results long --yes
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "long_1", *sys.argv[1:]]))
