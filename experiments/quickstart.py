"""Two teachers, three seeds each: a first campaign of a few minutes on a laptop, with its report.

python experiments/quickstart.py --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["quickstart", *sys.argv[1:]]))
