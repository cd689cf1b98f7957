"""Playground with given policies and a given task, opened in a browser."""

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
from tma_ray.runs.checkpoints import find_policy
from tma_ray.support.validation import check_fields, check_sequence, check_whole
from tma_ray.tasks import Dimension, TaskSpace
from tma_ray.viewing.rendering import parse_task

UNTRAINED: Final = {"random": RANDOM, "zero": ZERO}
MOST_POLICIES: Final = 4  # as many as fit on the page


@dataclass(frozen=True)
class PlaySettings:
    """Initial settings of the playground.

    Attributes:
        policies: "random" (uniform actions), "zero", folders of saved policies, or unambiguous prefixes of
            run ids in `results`.
        results: folder or URI of a results root.
        environment: name of the environment; None for that of the first trained policy, else Stump Tracks.
        embodiment: name of the body, with optional parameters; None for that of the policy, else the classic
            bipedal.
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
        if not 1 <= len(self.policies) <= MOST_POLICIES:
            raise ValueError(f"{len(self.policies)} policies: expected 1 to {MOST_POLICIES}")


def play(settings: PlaySettings, output: Path | None = None) -> Path:
    """Write the playground to `output`, or to a temporary file opened in a browser; return the path.

    Raises:
        ValueError: if a policy is unknown, unsupported or unfit for the body, or the environment or the task
            is not supported.
    """
    trained = [name for name in dict.fromkeys(settings.policies) if name not in UNTRAINED]
    records = [policy_record(find_policy(name, settings.results), settings.results) for name in trained]
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
        space = TaskSpace(tuple(Dimension(**dimension) for dimension in records[0]["space"]))
    task = parse_task(settings.task, space, made.valid_domain, np.random.default_rng([settings.seed, 0]))
    indices = tuple(
        UNTRAINED[name] if name in UNTRAINED else trained.index(name) for name in settings.policies
    )
    start = Start(environment, embodiment, indices, tuple(map(float, task)), settings.seed)
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
