"""Ray job that fills the object stores of all nodes, until its standard input ends.

python filled_stores.py ADDRESS
"""

import sys

import numpy as np
import ray
from nodes import OBJECT_STORE_BYTES
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

PIECE_BYTES = 20_000_000


@ray.remote(num_cpus=0)
def piece() -> np.ndarray:
    return np.ones(PIECE_BYTES, np.uint8)


if __name__ == "__main__":
    ray.init(address=sys.argv[1], log_to_driver=False)
    pieces = [
        piece.options(scheduling_strategy=NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)).remote()
        for node in ray.nodes()
        if node["Alive"]
        for _ in range(1 + OBJECT_STORE_BYTES // PIECE_BYTES)
    ]
    ray.wait(pieces, num_returns=len(pieces), fetch_local=False)
    sys.stdout.write("full\n")
    sys.stdout.flush()
    sys.stdin.read()
