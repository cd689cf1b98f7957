"""Hyper-parameters of the paper's tables, impossible ones, and the knowledge that each teacher uses."""

from typing import Any

import pytest
from simulated_play import SPACES, play, started

from tma_ray.tasks import KnowledgeLevel
from tma_ray.teachers import TEACHERS, effective_level, hyperparameters_of, make_teacher

NONE, LOW, HIGH = KnowledgeLevel

BEST_VALUES: dict[str, dict[str, Any]] = {
    "random": {},
    "adr": {"shrink_at": 0, "expand_at": 180, "boundary_share": 0.7, "queue_size": 10, "step": 0.1},
    "riac": {"region_capacity": 150, "split_attempts": 75, "smallest_side": 0.1},
    "covar_gmm": {"fit_every": 150, "most_components": 15, "explore": 0.1},
    "alp_gmm": {"fit_every": 150, "most_components": 10, "explore": 0.05},
    "goal_gan": {"noise": 0.01, "train_every": 100, "old_share": 0.2, "rollouts": 2},
    "spdl": {"first_update": 200_000, "update_every": 100_000, "updates_without_penalty": 0}
    | {"penalty_share": 0.05, "most_divergence": 0.8},
    "setter_solver": {"update_every": 100, "noise": 0.05, "hidden_units": 128},
}
"""The table of tuned hyper-parameters in appendix A, in its order."""

OF_THE_TEXT: dict[str, dict[str, Any]] = {
    "covar_gmm": {"progress": "absolute"},
    "goal_gan": {"least_success": 0.25, "most_success": 0.75, "spacing": 0.1},
    "setter_solver": {"learning_rate": 3e-4},
}
"""What appendix A says elsewhere."""

LAUNCHED: dict[str, dict[str, Any]] = {
    "goal_gan": {"noise": 0.1, "train_every": 100, "old_share": 0.1, "rollouts": 2},
    "spdl": {"first_update": 200_000, "update_every": 50_000, "updates_without_penalty": 10}
    | {"penalty_share": 0.25, "most_divergence": 0.1},
    "setter_solver": {"update_every": 50, "noise": 0.1, "hidden_units": 64},
}
"""The original release's launch files, where they differ from that table."""

TEACHERS_OF_LEVELS = {
    (NONE, NONE, NONE): "random riac plr robust_plr sobol lp_acrl perm procurl_target",
    (NONE, NONE, HIGH): "alp_gmm covar_gmm spdl accel spgl traced",
    (None, LOW, HIGH): "adr goal_gan currot doraemon",
    (None, LOW, LOW): "setter_solver sfl",
    (None, None, HIGH): "ramp",
}
"""Teachers by what they make of no, low and high knowledge; with None they cannot run."""


@pytest.mark.parametrize("name", BEST_VALUES)
def test_defaults_are_the_papers_best_values(name: str) -> None:
    expected = BEST_VALUES[name] | OF_THE_TEXT.get(name, {})
    values = hyperparameters_of(make_teacher(name))
    assert {key: values.get(key) for key in expected} == expected


@pytest.mark.parametrize("name", TEACHERS.names())
def test_the_preset_release_has_the_values_of_the_launch_files(name: str) -> None:
    if name not in LAUNCHED:
        assert not TEACHERS.get(name).presets
        return
    values = hyperparameters_of(make_teacher(f"{name}:preset=release"))
    papers = hyperparameters_of(make_teacher(name))
    assert {key: values[key] for key in LAUNCHED[name]} == LAUNCHED[name]
    assert {key for key in values if values[key] != papers[key]} <= set(LAUNCHED[name])


@pytest.mark.parametrize("name", TEACHERS.names())
def test_knowledge_is_used_or_refused_by_name(name: str) -> None:
    (levels,) = (each for each, names in TEACHERS_OF_LEVELS.items() if name in names.split())
    for given, used in zip(KnowledgeLevel, levels, strict=True):
        if used is None:
            refusal = f"teacher '{name}' cannot run with expert knowledge '{given}'"
            with pytest.raises(ValueError, match=refusal):
                effective_level(TEACHERS.get(name), name, given)
        else:
            assert effective_level(TEACHERS.get(name), name, given) is used


IMPOSSIBLE: dict[str, dict[str, Any]] = {
    "adr": {"shrink_at": 180.0, "queue_size": 0, "boundary_share": 1.1, "step": 0.0},
    "alp_gmm": {"fit_every": 2, "most_components": 1, "explore": 1.5, "exploer": 0.1},
    "covar_gmm": {"progress": "relative"},
    "goal_gan": {"noise": -0.1, "train_every": 0, "old_share": 1.2, "rollouts": 0, "least_success": 0.8}
    | {"spacing": -1.0, "iterations_per_task": 0.0, "learning_rate": 0.0},
    "setter_solver": {"update_every": 0, "noise": 1.5, "hidden_units": 0, "learning_rate": 0.0},
    "spdl": {"first_update": -1, "update_every": 0, "updates_without_penalty": -1}
    | {"penalty_share": -0.1, "most_divergence": 0.0},
    "riac": {"region_capacity": 3, "split_attempts": 0, "smallest_side": 0.0}
    | {"explore": 0.95, "mutate": -0.1, "mutation_std": -1.0},
    "doraemon": {"least_success": 1.0, "most_divergence": 0.0, "concentration": 1.0},
    "sfl": {"rollouts": 1, "kept": 0, "buffer_share": 2.0},
    "plr": {"temperature": 0.0, "replay_share": 1.5, "buffer_size": 0},
    "accel": {"edits": 0, "edit_step": 0.0, "edit_share": -0.1},
    "ramp": {"steps": 0},
    "robust_plr": {"budget": 0},
    "lp_acrl": {"cells": 1, "stage_episodes": 0, "temperature": 0.0, "budget": 0},
    "perm": {"windows": 0, "explore": 2.0, "bump_width": 0.0, "lowest_return": 400.0},
    "procurl_target": {"beta": 0.0, "pool_size": 0, "lowest_return": 400.0, "budget": 0},
    "spgl": {"budget": 0},
    "traced": {"score": "max_mc", "error_weight": -1.0, "round_size": 0, "memory": 0.0},
}


@pytest.mark.parametrize(("name", "key"), [(name, key) for name, keys in IMPOSSIBLE.items() for key in keys])
def test_impossible_hyperparameters_are_refused(name: str, key: str) -> None:
    with pytest.raises(ValueError, match=key):
        make_teacher(name, {key: IMPOSSIBLE[name][key]})


@pytest.mark.parametrize(
    ("name", "settings", "episodes", "updates"),
    [
        ("lp_acrl", {"stage_episodes": 100}, 25, 2),
        ("perm", {"window_episodes": 100}, 35, 3),
        ("spgl", {"first_update": 1_000, "update_every": 2_000}, 10, 1 + 5),
    ],
)
def test_waits_are_scaled_by_the_square_root_of_the_budget(name, settings, episodes, updates):
    """Of a hundredth of the paper's budget a tenth; episodes have 100 steps."""
    teacher = started(name, SPACES["line"], **settings, budget=200_000)
    play(teacher, episodes)
    assert len(teacher.drain_updates()) == updates
