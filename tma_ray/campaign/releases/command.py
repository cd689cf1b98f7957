"""The command that repeats a release for other teachers, having said what that costs."""

from __future__ import annotations

import argparse
from collections.abc import Collection

from tma_ray.campaign.costs.estimation import estimate
from tma_ray.campaign.options import SCHEDULE, chosen_nodes, chosen_settings
from tma_ray.campaign.releases.repeating import like_plan
from tma_ray.campaign.script import run_plan
from tma_ray.results import Results, Store, check_usable
from tma_ray.terminal import terminal

DECIDED = (
    *(
        "students",
        "embodiments",
        "expert-knowledge",
        "environment",
        "space",
        "environment-options",
        "test-set",
    ),
    *SCHEDULE,
    "independent-levels",
)
"""Options whose values the release has."""


def run_like(place: str, core: Collection[str], options: argparse.Namespace) -> int:
    """Runs what ``--teachers``, ``--challenges`` and ``--seeds`` choose of a release; returns the exit code.

    Args:
        place: folder or address of the release.
        core: campaigns of it that are repeated; empty for all.
        options: parsed options of ``tma-ray campaign``.

    Raises:
        ValueError: no teacher, an option whose value the release has, or what `like_plan` refuses.
        ResultsRootError: `place` is not a results root.
        ConnectionError: no cluster answers.
        RootInUseError: another campaign is running on the results root.
    """
    given = [f"--{name}" for name in DECIDED if getattr(options, name.replace("-", "_"))]
    if given:
        raise ValueError(
            f"--like takes {', '.join(given)} from the release; --teachers, --challenges and --seeds choose"
        )
    if not options.teachers:
        raise ValueError("which teachers? Name them with --teachers, as in --teachers mine:Teacher")
    plan = like_plan(
        options.name,
        Results.open(place),
        options.teachers,
        core,
        options.challenges or (),
        options.seeds or (),
    )
    if not options.dry_run:
        check_usable(Store.open(options.results))
    cost = estimate(plan, chosen_settings(options), nodes=chosen_nodes(options))
    terminal().print(cost.describe(), highlight=False, soft_wrap=True)
    return run_plan(plan, options.results, options, cost.throughputs)
