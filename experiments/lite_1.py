"""The runs of the release lite-1, a stage after the other: core, today, levels, parkour, seeds.

nice -n 19 python experiments/lite_1.py --stage core --results lite --yes
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "lite_1", *sys.argv[1:]]))
