"""The search for PPO's hyper-parameters.

python experiments/ppo_search.py --tier lite --results results
"""

import sys

from tma_ray.cli import main

if __name__ == "__main__":
    sys.exit(main(["experiment", "ppo_search", *sys.argv[1:]]))
