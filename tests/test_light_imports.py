"""Heavy libraries are imported by what needs them, and by nothing else: a start is mostly imports."""

import json
from dataclasses import dataclass

import pytest
from suite.processes import python

LEARNING = frozenset({"torch", "stable_baselines3"})
PLOTTING = frozenset({"matplotlib", "pygame"})


@dataclass(frozen=True)
class Step:
    """A statement of a fresh process, and the libraries that may not be there after it."""

    name: str
    statement: str
    forbidden: frozenset[str]


STEPS = (
    Step(
        "list of commands",
        "from tma_ray import cli\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        "    cli.main(['--help'])",
        LEARNING | PLOTTING | {"ray", "pandas", "pyarrow", "numba", "scipy", "analysis", "gymnasium"},
    ),
    Step(
        "names of everything",
        "quietly(['list'])",
        LEARNING | PLOTTING | {"ray", "pandas", "pyarrow", "numba", "scipy", "analysis", "gymnasium"},
    ),
    Step(
        "names known to gymnasium",
        "import gymnasium, tma_ray.envs\n"
        "assert tma_ray.envs.make_environment\n"
        "assert gymnasium.spec('tma_ray/StumpTracks-v0')",
        LEARNING | PLOTTING | {"ray", "pandas", "pyarrow", "numba", "scipy", "analysis"},
    ),
    Step(
        "names of worlds",
        "import tma_ray.physics, tma_ray.envs",
        LEARNING | {"numba", "pymunk", "ray", "pygame"},
    ),
    Step(
        "analysis",
        "import analysis",
        LEARNING | PLOTTING | {"scipy", "jinja2", "plotly", "ray", "sklearn", "numba"},
    ),
    Step(
        "a baseline",
        "from analysis.baselines import find_baseline\n"
        "assert len(find_baseline('lite-1').frames().evaluations)",
        LEARNING | PLOTTING | {"ray", "numba", "pymunk"},
    ),
    Step(
        "conformance kit",
        "import tma_ray.testing",
        LEARNING | PLOTTING | {"pytest", "ray", "numba", "pymunk"},
    ),
    Step(
        "names and values of students",
        "import tma_ray.students as s; s.default_hyperparameters('ppo'); s.STUDENTS.names()",
        LEARNING | PLOTTING | {"ray"},
    ),
    Step(
        "classes of teachers",
        "from tma_ray.teachers import TEACHERS\nassert all(map(TEACHERS.get, TEACHERS.names()))",
        LEARNING | PLOTTING | {"ray"},
    ),
    Step("loggers", "import analysis.tracking", LEARNING | {"ray", "tensorboardX", "wandb"}),
    Step("pages", "import analysis.pages.report", LEARNING | {"ray", "pymunk", "matplotlib.pyplot"}),
    Step(
        "training worlds",
        "env = gymnasium.make('tma_ray/StumpTracks-v0', embodiment='classic_bipedal')\n"
        "assert env.spec.max_episode_steps is None\n"
        "assert env.reset(seed=0, options={'task': [1, 2]})[0].shape == (24,)",
        LEARNING | {"pygame", "ray"},
    ),
    Step(
        "actors",
        "import tma_ray.campaign.executors.actors, tma_ray.campaign.execution",
        LEARNING | {"pygame", "sklearn"},
    ),
    Step(
        "teachers",
        "from tma_ray.runs import *\n"
        "spec = effective_spec(Cell(student='ppo', teacher='alp_gmm'), 0, Schedule())\n"
        "InlineTeacher(spec).exchange(None)",
        LEARNING | {"pygame", "sklearn"},
    ),
)
"""What one process does, one after the other, those that need least first."""

SCRIPT = """
import contextlib, io, json, sys
sys.orig_argv[1:1] = ["tma-ray"]  # as in a process of the command
def quietly(arguments):
    with contextlib.redirect_stdout(io.StringIO()):
        assert cli.main(arguments) == 0
loaded = {}
"""


@pytest.fixture(scope="module")
def loaded() -> dict[str, set[str]]:
    """Modules that are there after each step."""
    lines = [f"{step.statement}\nloaded[{step.name!r}] = sorted(sys.modules)" for step in STEPS]
    script = "\n".join([SCRIPT, *lines, "print(json.dumps(loaded))"])
    return {name: set(modules) for name, modules in json.loads(python("-c", script)).items()}


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.name)
def test_no_more_is_imported_than_needed(step: Step, loaded: dict[str, set[str]]) -> None:
    assert not step.forbidden & loaded[step.name]
