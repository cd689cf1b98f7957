"""Results roots, releases and policies of every format that was ever published, and that load for ever.

A folder `version_N` holds a root and a release of two short runs as the code of that time wrote them, and
`expected.json`: what their policies did, and what they returned in evaluations, as that code read it.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis import load
from analysis.baselines.verification import verify
from tma_ray.results import Results, RunStatus, Table
from tma_ray.runs import RunSpec
from tma_ray.students import load_policy

VERSIONS = sorted(Path(__file__).parent.glob("version_*"))


@pytest.fixture(params=VERSIONS, ids=lambda version: version.name)
def version(request: pytest.FixtureRequest) -> Path:
    """Folder of one version."""
    return Path(request.param)


@pytest.fixture
def expected(version: Path) -> dict[str, Any]:
    """What was known of the version's runs when it was stored, by run id."""
    content: dict[str, Any] = json.loads((version / "expected.json").read_text())
    return content


@pytest.mark.parametrize("place", ["root", "release"])
def test_tables_load(version: Path, expected: dict[str, Any], place: str) -> None:
    results = Results.open(version / place)
    manifests = {manifest.run.run_id: manifest for manifest in results.runs()}
    assert set(manifests) == set(expected)
    assert not results.problems
    assert {manifest.status for manifest in manifests.values()} == {RunStatus.DONE}
    for table in Table:
        assert results.table(table).num_rows > 0, table


@pytest.mark.parametrize("place", ["root", "release"])
def test_evaluations_are_those_that_were_written(version: Path, expected: dict[str, Any], place: str) -> None:
    evaluations = load(version / place).evaluations.sort_values(["step", "task_index"])
    for run_id, run in expected.items():
        rows = evaluations[evaluations["run_id"] == run_id]
        assert rows["episodic_return"].tolist() == run["evaluated_returns"]


def test_releases_are_whole(version: Path) -> None:
    assert not verify(version / "release").problems


def test_specs_are_understood(version: Path, expected: dict[str, Any]) -> None:
    for manifest in Results.open(version / "root").runs():
        content = json.loads(manifest.run.spec)
        assert RunSpec.from_dict(content).student == expected[manifest.run.run_id]["student"]


@pytest.mark.parametrize("place", ["root", "release"])
def test_policies_act_as_they_did(version: Path, expected: dict[str, Any], place: str) -> None:
    for run_id, run in expected.items():
        policy = load_policy(run["student"], version / place / "policies" / run_id)
        actions = policy(np.array(run["observations"], np.float32))
        np.testing.assert_allclose(actions, run["actions"], rtol=1e-5, atol=1e-6)
