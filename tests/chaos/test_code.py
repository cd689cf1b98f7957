"""Code of the user's that raises: its run fails, the others go on, and the same command makes up for it."""

from __future__ import annotations

import time

import pytest
from faults import Fault, Site
from test_processes import check

from tma_ray.results import Results, RunStatus

pytestmark = pytest.mark.chaos


@pytest.mark.parametrize("part", ["teacher", "environment", "student"])
def test_a_part_that_raises(
    clustered: Site, undisturbed: dict[str, bytes], faults: list[Fault], part: str
) -> None:
    clustered.ask(f"raise-in-{part}")
    clustered.finish(clustered.start(), 1)
    runs = Results.open(clustered.root).runs()
    assert sorted(run.status for run in runs) == [RunStatus.DONE, RunStatus.FAILED]
    (failed,) = (run for run in runs if run.status is RunStatus.FAILED)
    assert "own mistake" in str(failed.error)
    assert "saboteur.py" in str(failed.error), "the traceback names the file"
    assert "\x1b" not in str(failed.error)
    assert clustered.outcomes() == ["done", "failed"], "it was not tried again"
    fault = time.time()
    clustered.finish(clustered.start())
    check(clustered.compare(f"{part} raises", 1, undisturbed, [fault]), faults)
