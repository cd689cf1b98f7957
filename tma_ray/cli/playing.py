"""Options that commands which show a policy have in common."""

from __future__ import annotations

import argparse

from tma_ray.commands.places import root
from tma_ray.commands.quantities import COUNT, SEED
from tma_ray.commands.texts import named

TASK = "values as 0.5,3, pairs as stump_height=0.5,obstacle_spacing=3, or random"


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Adds the options that choose environment, body, policy and seed."""
    parser.add_argument(
        "--environment",
        type=named("the name of an environment"),
        metavar="NAME",
        help="environment (default: the run's, else stump_tracks)",
    )
    parser.add_argument(
        "--embodiment",
        type=named("the name of a body"),
        metavar="NAME",
        help="body (default: the run's, else classic_bipedal)",
    )
    parser.add_argument(
        "--policy",
        type=named("a policy"),
        default="random",
        metavar="POLICY",
        help="a run, the folder of a saved policy, random (uniform actions) or zero (none)",
    )
    parser.add_argument(
        "--results", type=root, default="results", metavar="ROOT", help="results root of the run"
    )
    parser.add_argument(
        "--seed", type=SEED, default=0, metavar="N", help="seed of worlds, random tasks and random actions"
    )


def add_episode(group: argparse._ActionsContainer) -> None:
    """Adds the options that limit an episode and its frames."""
    group.add_argument(
        "--steps", type=COUNT, default=1000, metavar="N", help="steps after which an episode is left"
    )
    group.add_argument("--every", type=COUNT, default=2, metavar="N", help="steps from one frame to the next")
