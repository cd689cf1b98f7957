"""The playground with chosen policies and a task, as a file that a browser opens."""

import tempfile
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from tma_ray.embodiments import load_embodiment
from tma_ray.envs import make_environment
from tma_ray.playground.contents import PLAYED
from tma_ray.playground.page import RANDOM, ZERO, Start, page_html, policy_record
from tma_ray.runs.saved_policies import find_policy
from tma_ray.support.validation import check_fields, check_sequence, check_whole
from tma_ray.tasks import TaskSpace
from tma_ray.viewing.rendering import parse_task

UNTRAINED: Final = {"random": RANDOM, "zero": ZERO}

MOST: Final = 4
"""Largest number of policies that the page plays at once."""


@dataclass(frozen=True)
class PlaySettings:
    """Settings of the playground: what it plays first.

    Attributes:
        policies: each "random" (uniform actions), "zero" (all zero), the folder of a saved policy, or a run
            of `results`: its id or an unambiguous beginning of it.
        results: folder or URI of a results root.
        environment: name of an environment that the page has; None for that of the first trained policy, else
            Stump Tracks.
        embodiment: name of the body, with parameters if wanted; None for that of the policy, else
            the classic bipedal.
        task: text for `parse_task`; None for the middle of the task space.
        seed: seed of the page's worlds and of random tasks.
    """

    policies: tuple[str, ...] = ("random",)
    results: str | Path = "results"
    environment: str | None = None
    embodiment: str | None = None
    task: str | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        check_whole("seed", self.seed, 0)
        check_sequence("policies", self.policies)
        if not 1 <= len(self.policies) <= MOST:
            raise ValueError(f"{len(self.policies)} policies: expected 1 to {MOST}")


def play(settings: PlaySettings, output: Path | None = None) -> Path:
    """Write the playground and open it in a browser, unless it was written to a given file.

    Returns:
        The file.

    Raises:
        ValueError: no such policy, one that the page cannot show or that does not fit the body, an
            environment that the page does not have, or a task outside its valid domain.
    """
    named = [name for name in dict.fromkeys(settings.policies) if name not in UNTRAINED]
    records = [policy_record(find_policy(name, settings.results), settings.results) for name in named]
    first: dict[str, Any] = (
        records[0] if records else {"environment": PLAYED[0], "embodiment": "classic_bipedal"}
    )
    environment = settings.environment or first["environment"]
    embodiment = settings.embodiment or first["embodiment"]
    if environment not in PLAYED:
        raise ValueError(f"environment {environment!r}: the playground has {' and '.join(PLAYED)}")
    made: Any = make_environment(environment, embodiment=load_embodiment(embodiment))
    for record in records:
        sizes = record["sizes"][0], record["sizes"][-1]
        if sizes != (*made.observation_space.shape, *made.action_space.shape):
            raise ValueError(
                f"the policy of {record['name']} does not fit {environment} with {embodiment}; it was "
                f"trained in {record['environment']} with {record['embodiment']}"
            )
    space: TaskSpace = made.task_space
    if records and records[0]["environment"] == environment:
        bounds = {each["name"]: (each["low"], each["high"]) for each in records[0]["space"]}
        space = TaskSpace.from_bounds(bounds)
    task = parse_task(settings.task, space, made.valid_domain, np.random.default_rng([settings.seed, 0]))
    places = tuple(UNTRAINED[name] if name in UNTRAINED else named.index(name) for name in settings.policies)
    start = Start(environment, embodiment, places, tuple(map(float, task)), settings.seed)
    page = page_html(records, start)
    if output is not None:
        output.write_text(page, encoding="utf-8")
        return output
    with tempfile.NamedTemporaryFile(
        "w", prefix="tma_ray-", suffix=".html", encoding="utf-8", delete=False
    ) as file:
        file.write(page)
    webbrowser.open(Path(file.name).as_uri())
    return Path(file.name)
