"""The paper's case studies: climbing, expert knowledge, what ADR needs, students that forget.

python experiments/case_studies.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "case_studies", *sys.argv[1:]]))
