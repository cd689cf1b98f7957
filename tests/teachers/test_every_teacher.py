"""Every teacher of the catalogue keeps the contract of the conformance kit."""

from typing import Any

import pytest
from simulated_play import started

from tma_ray.tasks import TaskSpace
from tma_ray.teachers import TEACHERS, check_limits
from tma_ray.testing import TeacherConformance
from tma_ray.testing.scenarios import SCENARIOS

TINY: dict[str, dict[str, Any]] = {
    **{name: {"most_components": 3} for name in ("alp_gmm", "covar_gmm")},
    **{name: {"buffer_size": 30} for name in ("accel", "plr", "robust_plr", "traced")},
    "goal_gan": {"pretraining_iterations": 10, "iterations_per_task": 0.1},
    "setter_solver": {"hidden_units": 4},
    "sfl": {"refresh_every": 100, "candidates": 20},
    "currot": {"particles": 40},
    "doraemon": {"update_every": 40_000},
    "lp_acrl": {"cells": 4, "stage_episodes": 40},
    "perm": {"window_episodes": 50, "bumps": 10},
    "procurl_target": {"first_update": 40_000, "update_every": 80_000, "pool_size": 50},
    "spgl": {"first_update": 40_000, "update_every": 40_000},
}
"""Where the defaults take longest."""

DEFAULT_EVERYWHERE = ("doraemon", "lp_acrl", "spgl")
"""Of these, the ones that the slow tier leaves at their defaults."""

FEW = tuple(scenario for scenario in SCENARIOS if scenario.name in ("plane", "rugged"))
"""Of which the fast tier gives every second teacher the plane and the others the rugged one."""

FEWER_EPISODES = 215
"""Of each play in the fast tier: more than the kit saves after."""

IN_NEW_PROCESSES = ("riac",)
"""Teachers that the fast tier continues in a new process, too; the slow tier does so with all."""


class FastConformance(TeacherConformance):
    """The kit without its new process, which has to import everything anew."""

    @pytest.mark.slow
    def test_a_saved_teacher_continues_in_a_new_process(self) -> None:
        """Bit for bit, after any number of episodes."""
        super().test_a_saved_teacher_continues_in_a_new_process()


for _place, _name in enumerate(TEACHERS.names()):
    _members = {"teacher": TEACHERS.get(_name), "hyperparameters": TINY.get(_name, {})}
    _fewer = {**_members, "scenarios": FEW[_place % 2 :: 2], "episodes": FEWER_EPISODES}
    _kind = TeacherConformance if _name in IN_NEW_PROCESSES else FastConformance
    globals()[f"Test_{_name}"] = type(f"Test_{_name}", (_kind,), _fewer)
    if _name in DEFAULT_EVERYWHERE:
        _members["hyperparameters"] = {}
    _kept = type(f"Test_{_name}_everywhere", (TeacherConformance,), _members)
    globals()[_kept.__name__] = pytest.mark.slow(_kept)


SINGLE = TaskSpace.from_bounds({"stump_height": (1, 1), "obstacle_spacing": (4, 4)})


@pytest.mark.parametrize("name", TEACHERS.names())
def test_a_space_of_a_single_task_is_taught_or_declined_beforehand(name: str) -> None:
    """A limit is declared exactly where a teacher refuses to start."""
    teacher = TEACHERS.get(name)
    if teacher.refusal(SINGLE):
        with pytest.raises(ValueError, match=r"teacher .* does not teach in a space of a single task"):
            check_limits(teacher, name, SINGLE)
        with pytest.raises(ValueError, match="nothing to choose"):
            started(name, SINGLE)
    else:
        assert started(name, SINGLE).propose().task.tolist() == [1, 4]
