"""Mistakes in calls from Python: each is refused where it is made, in a sentence that names it."""

import dataclasses
from importlib import import_module
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from api_mistakes import ACCEPTED, MISTAKES
from pandas import Series

import analysis
from analysis import baselines, statistics
from tma_ray.campaign import Campaign, CampaignSpec, cells_of
from tma_ray.campaign.settings import ExecutionConfig, Resources
from tma_ray.embodiments import load_embodiment
from tma_ray.envs import make_environment
from tma_ray.export import export
from tma_ray.runs import Cell, Placement, Schedule
from tma_ray.students.rollout_workers import CohortSettings
from tma_ray.tasks import Dimension, TaskSpace
from tma_ray.testing import StudentParameters, find_simulated_challenge
from tma_ray.viewing.play import PlaySettings
from tma_ray.viewing.rendering import EpisodeSettings

ROOT = Path(__file__).parents[1] / "notebooks" / "data" / "ppo-lite"

PACKAGES = ("benchmark", "campaign", "envs", "results", "runs", "students", "tasks", "teachers", "testing")
MODULES = (*(import_module(f"tma_ray.{name}") for name in PACKAGES), statistics)

CONFIGURATIONS = (
    *(Campaign, Cell, CohortSettings, Dimension, EpisodeSettings, Placement, PlaySettings, Resources),
    *(Schedule, ExecutionConfig, StudentParameters, TaskSpace),
)

OTHERS = (Resources, ExecutionConfig, load_embodiment, export, analysis, baselines, gym, np, Series)


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the calls name: all that is public, and some of what it makes."""
    found = {name: getattr(module, name) for module in MODULES for name in module.__all__}
    found |= {each.__name__.rpartition(".")[2]: each for each in OTHERS} | {
        "np": np,
        "gym": gym,
        "nan": np.nan,
    }
    frames = analysis.load(ROOT)
    runs = analysis.runs_after(frames)
    dimensions = Dimension("a", 0, 1), Dimension("b", 0, 2)
    return found | {
        "F": frames,
        "R": runs,
        "RID": runs["run_id"].iloc[0],
        "P": analysis.pooled(runs),
        "T": analysis.pairwise(runs, "mastered_percent"),
        "curves": analysis.evaluation_curves(frames),
        "simulated": find_simulated_challenge("original"),
        "seeds": np.random.SeedSequence(0),
        "plan": lambda cells: CampaignSpec("x", cells).plan(),
        "ROOT": str(ROOT),
        "tmp": tmp_path_factory.mktemp("api"),
        "space": TaskSpace(dimensions),
        "rng": np.random.default_rng(0),
        "cells": cells_of(("random",)),
        "env": lambda: make_environment("stump_tracks"),
        "box": gym.spaces.Box(-1, 1, (3,), np.float32),
    }


def test_mistakes_are_refused_in_a_sentence(names: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(names["tmp"])
    problems = []
    for call, said in MISTAKES.items():
        kind, _, text = said.partition(": ")
        try:
            problems.append(f"{call}: accepted, {eval(call, dict(names))!r:.60}")
        except {"Type": TypeError, "Value": ValueError}[kind] as error:
            if text not in str(error):
                problems.append(f"{call}: {error}")
        except Exception as error:
            problems.append(f"{call}: {error!r}")
    assert len(MISTAKES) > 200
    assert problems == []


@pytest.mark.parametrize("kind", CONFIGURATIONS)
@pytest.mark.parametrize("wrong", [object(), 1j])
def test_no_field_of_a_configuration_takes_a_value_of_another_type(kind: Any, wrong: object) -> None:
    needed = {Campaign: {"name": "x", "cells": (Cell(),)}, Dimension: {"name": "a", "low": 0, "high": 1}}
    for field in dataclasses.fields(kind):
        words = field.name.removesuffix("s").replace("_", ".")
        with pytest.raises((TypeError, ValueError), match=f"{words}.*expected"):
            kind(**{**needed.get(kind, {}), field.name: wrong})


@pytest.mark.parametrize("call", ACCEPTED)
def test_what_only_looks_like_a_mistake_is_accepted(names: dict[str, Any], call: str) -> None:
    eval(call, dict(names))
