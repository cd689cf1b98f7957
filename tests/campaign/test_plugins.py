"""Plug-ins on a cluster that others started: a head node of its own, whose workers know nobody's folders."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from local_head import local_head
from small_runs import rows

from tma_ray.results import Results, Table

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
HELPER = "LEVEL = 0.25\n"

SCRIPT = '''
from dataclasses import dataclass

import numpy as np
from helper import LEVEL
from idle_student import Idle

from tma_ray.campaign import Campaign
from tma_ray.envs import ENVIRONMENTS
from tma_ray.runs import Cell, Schedule
from tma_ray.students import STUDENTS
from tma_ray.tasks import TeacherUpdate
from tma_ray.teachers import Teacher, register_teacher
from world import World

ENVIRONMENTS.register("world")(World)

@register_teacher("steady")
@dataclass
class Steady(Teacher):
    """Always the same task; its log says where its code lies."""

    def sample(self):
        return self.space.denormalise(np.full(self.space.size, LEVEL))

    def observe(self, episode):
        self.log(TeacherUpdate(scalars={"shipped": float("tma_ray_plugins" in __file__)}))

STUDENTS.register("idle")(Idle)

cells = (Cell("world", "original", "", "idle", "steady"),)
campaign = Campaign("mine", cells, (0,), Schedule(200, 200, 200, 3, 200))
'''

GUARDED = SCRIPT + "if __name__ == '__main__':\n    campaign.main()\n"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with local_head() as head, pytest.MonkeyPatch.context() as patch:
        patch.delenv("RAY_AUTH_TOKEN", raising=False)
        for name in head.environment.keys() - os.environ.keys() | {"HOME"}:
            patch.setenv(name, head.environment[name])
        yield head.address


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A user's folder with a script, and three modules beside it."""
    folder = tmp_path / "user"
    folder.mkdir()
    (folder / "script.py").write_text(GUARDED)
    (folder / "helper.py").write_text(HELPER)
    (folder / "idle_student.py").write_text(Path(__file__).with_name("idle_student.py").read_text())
    corridor = (ROOT / "tests/runs/corridor.py").read_text()
    (folder / "world.py").write_text(corridor.replace("Corridor", "World"))
    return folder


def start(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], cwd=cwd, capture_output=True, text=True)


def test_a_script_with_everything_of_its_own_runs_on_a_cluster(address: str, folder: Path) -> None:
    root, elsewhere = folder.parent / "root", folder.parent
    command = str(folder / "script.py"), "--address", address, "--results", str(root)

    def campaign() -> tuple[list[float], int]:
        """Run the script; return the distances of all tasks taught, and how many attempts there were."""
        done = start(*command, cwd=elsewhere)
        assert done.returncode == 0, done.stdout + done.stderr
        taught = {row["task"][0] for row in rows(root, Table.EPISODES)}
        return sorted(taught), len(rows(root, Table.ATTEMPTS))

    assert campaign() == ([2.75], 1)
    assert {scalar for row in rows(root, Table.TEACHER_LOG) for scalar in row["scalars"]} == {("shipped", 1)}
    (folder / "helper.py").write_text("LEVEL = 0.5\n")
    assert campaign() == ([2.75, 4.5], 2), "the edited helper makes another teacher"
    assert len(Results.open(root).runs()) == 2


def test_a_body_in_a_file_reaches_the_workers(address: str, folder: Path) -> None:
    root, body = folder.parent / "root", folder / "hopper.toml"
    body.write_text((ROOT / "examples/hopper.toml").read_text())
    names = "--embodiments", "hopper.toml", "--students", "idle_student:Idle", "--teachers", "random"
    sizes = "--seeds", "1", "--steps", "20", "--results", str(root), "--address", address

    def campaign() -> list[str]:
        """Run the command; return the bodies of all runs that are done."""
        done = start("-m", "tma_ray", "campaign", *names, *sizes, cwd=folder)
        assert done.returncode == 0, done.stdout + done.stderr
        return [run["embodiment"] for run in rows(root, Table.RUNS) if run["status"] == "done"]

    assert campaign() == ["hopper.toml"]
    assert campaign() == ["hopper.toml"]
    body.write_text(body.read_text() + "# edited\n")
    assert campaign() == ["hopper.toml"] * 2, "the edited body makes another run"


def test_a_script_that_starts_its_campaign_on_import_is_refused(address: str, folder: Path) -> None:
    call = f"execute_plan(campaign.plan(), 'results', address='{address}')\n"
    imports = "from tma_ray.campaign.execution import execute_plan\n"
    (folder / "script.py").write_text(SCRIPT + imports + call)
    done = start("script.py", cwd=folder)
    assert done.returncode != 0
    assert "put the call below 'if __name__" in done.stderr
    assert not (folder / "results").exists()


def test_an_example_learns(address: str, tmp_path: Path) -> None:
    (tmp_path / "three.csv").write_text("mass,length\n0.2,0.6\n0.5,0.6\n1,0.5\n")
    arguments = (
        "experiment.py --teachers frontier_teacher:Frontier --seeds 1 --steps 2000 "
        f"--evaluation-interval 2000 --probe-interval 500 --test-set {tmp_path / 'three.csv'} "
        f"--memory-per-run 0.5 --address {address} --results {tmp_path / 'root'}"
    )
    done = start(*arguments.split(), cwd=ROOT / "examples")
    assert done.returncode == 0, done.stdout + done.stderr
    (run,) = Results.open(tmp_path / "root").runs()
    assert run.run.teacher == "frontier_teacher:Frontier"
    assert json.loads(run.run.spec)["mastery_threshold"] == -200
    tested = rows(tmp_path / "root", Table.EVALUATIONS)
    first, last = (sum(row["episodic_return"] for row in tested if row["step"] == at) for at in (0, 2000))
    assert last > 0.85 * first, "costs have fallen"
