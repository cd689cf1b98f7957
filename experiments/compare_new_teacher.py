"""The full benchmark for teachers of your own, beside released results or Random.

python experiments/compare_new_teacher.py --teachers mine:Teacher,random --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "compare_new_teacher", *sys.argv[1:]]))
