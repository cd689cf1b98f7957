import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tma_ray.results import Committer, Results, RunWriter, Table

TASKS = 100

WRITER = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from itertools import count
from results_examples import make_record
from tma_ray.results import Committer, RunWriter, Store, Table

store = Store.open(sys.argv[1])
committer, record = Committer(store), make_record("run-1")
writer = RunWriter(store, "run-1", committer.start(record))
for step in count():
    writer.add(Table.EVALUATIONS, [
        dict(step=step, test_set="grid", task_index=i, task=[0.0, 1.0], episodic_return=i / 3, length=9)
        for i in range({TASKS})
    ])
    committer.publish(record, 0, writer.flush())
    print(step, flush=True)
"""


@pytest.fixture(params=["disk", pytest.param("s3", marks=pytest.mark.slow)])
def root(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(request.getfixturevalue("s3_root")) if request.param == "s3" else str(tmp_path)


@pytest.mark.parametrize(
    "kill_after", [4, *(pytest.param(count, marks=pytest.mark.slow) for count in (1, 9))]
)
def test_a_writer_that_is_killed_loses_nothing_it_had_published(root: str, kill_after: int) -> None:
    with subprocess.Popen([sys.executable, "-c", WRITER, root], stdout=subprocess.PIPE, text=True) as process:
        for _ in range(kill_after):
            published = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
    results = Results.open(root)
    rows = results.table(Table.EVALUATIONS).to_pydict()
    evaluations = len(rows["step"]) // TASKS
    assert evaluations > published
    assert rows["step"] == [step for step in range(evaluations) for _ in range(TASKS)]
    assert rows["task_index"] == list(range(TASKS)) * evaluations
    assert results.problems == []

    committer = Committer.open(root)
    record, parts = results.runs()[0].run, results.runs()[0].files
    successor = RunWriter(committer.store, "run-1", committer.start(record), parts)
    committer.finish(record, successor.attempt, successor.finish())
    assert Results.open(root).table(Table.EVALUATIONS).to_pydict() == rows
