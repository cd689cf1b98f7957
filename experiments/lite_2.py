"""The runs of the release lite-2, a stage after the other: core, later, authors, levels, parkour, seeds.

nice -n 19 python experiments/lite_2.py --stage core --results lite --yes
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "lite_2", *sys.argv[1:]]))
