"""Plug-in that compiles all kernels once, before parallel processes would compile them separately."""

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
PACKAGE = TESTS.parent / "tma_ray"
WITH_KERNELS = ("support/jit.py", "physics", "students", "terrain")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before a parallel run of the whole suite; fewer tests compile on demand."""
    config = session.config
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if not whole or not getattr(config.option, "numprocesses", None) or hasattr(config, "workerinput"):
        return
    sources, compiled = _sources(), config.cache.get("tma_ray/kernels", {})
    if compiled.get("sources") != sources or not set(compiled["files"]) <= set(_compiled()):
        config.get_terminal_writer().line("compiling kernels …")
        command = [sys.executable, "-m", "suite.kernels", *map(str, (TESTS, TESTS / "runs"))]
        subprocess.run(command, cwd=TESTS, check=True)
        config.cache.set("tma_ray/kernels", {"sources": sources, "files": _compiled()})


def compile_all(folder: Path) -> None:
    """Compile all kernels by short runs with every kind of world, sensor and student."""
    import numpy as np
    from small_runs import run, stump_tracks_spec

    from tma_ray.envs import make_environment

    for student in ("ppo", "sac"):
        short = dict.fromkeys(("steps", "evaluation_interval", "training_window"), 500)
        spec = stump_tracks_spec(folder, student, "random", **short)
        run(spec, folder / student)
    for body in ("classic_bipedal", "fish", "climbing_chimpanzee"):
        world = make_environment("parkour", embodiment=body)
        for task in world.task_space.sample(np.random.default_rng(0), 2):
            world.reset(seed=0, options={"task": task})
            for _ in range(5):
                world.step(world.action_space.sample())


def _sources() -> str:
    content = hashlib.sha256(sys.version.encode())
    for name in WITH_KERNELS:
        place = PACKAGE / name
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            content.update(path.read_bytes())
    return content.hexdigest()


def _compiled() -> list[str]:
    return sorted(str(path.relative_to(PACKAGE)) for path in PACKAGE.rglob("*.nbi"))


if __name__ == "__main__":
    import tempfile

    sys.path[:0] = sys.argv[1:]
    with tempfile.TemporaryDirectory() as place:
        compile_all(Path(place))
