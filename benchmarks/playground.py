"""Agreement of the playground's physics with Python's: a row per body and environment.

python benchmarks/playground.py > benchmarks/measured/playground.csv
"""

from __future__ import annotations

import argparse
import csv
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tma_ray.embodiments import embodiment_names
from tma_ray.playground.contents import PLAYED

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "playground"))
sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "making"))

from browsers import chromium  # type: ignore[import-not-found]
from replays import (  # type: ignore[import-not-found]
    in_chromium,
    in_node,
    recorded,
    sine_of_the_page,
)

CLOSE = 1e-9
"""Largest difference between states that are considered equal, in SI units."""


def largest(episode: dict[str, Any]) -> float:
    """Return the largest difference in an observation, a reward or a state."""
    return float(max(episode["state"], episode["observed"], episode["reward"]))


def cells(places: Sequence[list[dict[str, Any]]], exact: list[dict[str, Any]]) -> list[object]:
    """Return the columns of a row besides body and environment.

    Args:
        places: episodes in node and in Chromium with the page's sine and cosine.
        exact: episodes in node with this machine's sine and cosine.
    """
    bits = [sum(largest(each) == 0 for each in episodes) for episodes in places]
    ends = [sum(each["ending"] for each in episodes) for episodes in (*places, exact)]
    close = sum(each["state"] < CLOSE for each in exact)
    state = max(each["state"] for each in exact)
    return [len(exact), *bits, min(ends), close, f"{state:.0e}" if state else "0"]


def main() -> None:
    """Print the table as CSV."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--episodes", type=int, default=20, help="episodes of a row (%(default)s)")
    parser.add_argument("--steps", type=int, default=200, help="steps of an episode (%(default)s)")
    parser.add_argument("--bodies", default=",".join(embodiment_names()), help="bodies (all)")
    options = parser.parse_args()
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(
        [
            *("body", "environment", "episodes", "equal in every bit in node", "in Chromium", "same end"),
            *("glibc's sine: states within 1e-9", "largest difference"),
        ]
    )
    with tempfile.TemporaryDirectory() as name, chromium() as browser:
        sine = sine_of_the_page(Path(name))
        for body in options.bodies.split(","):
            played = []
            for number, variables in enumerate((sine, {})):
                place = Path(name) / f"{body}-{number}"
                place.mkdir()
                files = recorded(place, options.episodes, options.steps, (body,), variables)
                played.append(in_node(place, *files))
                if variables:
                    played.append(in_chromium(browser, *files))
            for row, environment in enumerate(sorted(PLAYED)):
                *places, exact = (each[row] for each in played)
                table.writerow([body.replace("_", " "), environment.replace("_", " "), *cells(places, exact)])
            sys.stdout.flush()


if __name__ == "__main__":
    main()
