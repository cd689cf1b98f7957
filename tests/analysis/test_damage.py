"""Damage of one file: it is named, its run is left out and done again, and everything else goes on.

A root holds a run for every kind of damage, and some that are whole. Each reader sees it once.
"""

import io
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from synthetic_results import SyntheticCampaign

from analysis import load
from analysis.baselines import BaselineError, find_baseline, release, verify
from analysis.commands.rankings import show_ranking
from tma_ray.campaign.progress import overview, show_status
from tma_ray.results import (
    Committer,
    DamagedFileWarning,
    NotRunningError,
    Results,
    ResultsRootError,
    RunRecord,
    Store,
    Table,
    ask_to_stop,
    compact,
    verify_root,
)

pytestmark = pytest.mark.filterwarnings("ignore::tma_ray.results.DamagedFileWarning")

WHOLE = 3
"""How many runs are whole."""


def mistyped(**values: Any) -> Callable[[bytes], bytes]:
    """Damage that gives fields of a manifest, or of its run or first file, other values."""

    def damage(data: bytes) -> bytes:
        content = json.loads(data)
        for name, value in values.items():
            place = next(part for part in (content, content["run"], content["files"][0]) if name in part)
            place[name] = value
        return json.dumps(content).encode()

    return damage


def twice(data: bytes) -> bytes:
    content = json.loads(data)
    content["files"] += content["files"][:1]
    return json.dumps(content).encode()


ANY_FILE: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda data: data[: len(data) // 2],
    "empty": lambda data: b"",
    "an object": lambda data: b"{}",
    "a list": lambda data: b"[]",
    "another encoding": lambda data: "{}".encode("utf-16"),
    "a deep list": lambda data: b"[" * 100_000,
    "no text": lambda data: b'{"format": "\xff\xfe"}',
}

MANIFEST = ANY_FILE | {
    "seed is null": mistyped(seed=None),
    "error is a number": mistyped(error=5),
    "steps are text": mistyped(steps="x"),
    "steps are huge": mistyped(steps=10**30),
    "attempt is a fraction": mistyped(attempt=0.5),
    "status is unknown": mistyped(status="finished"),
    "rows are negative": mistyped(rows=-1),
    "a path leads out": mistyped(path="../secret"),
    "files are a number": mistyped(files=3),
    "the spec is no JSON": mistyped(spec="{"),
    "the spec is another's": mistyped(spec='{"seed": 12345}'),
    "another run's manifest": mistyped(run_id="other"),
    "another run's table": mistyped(path="tables/evaluations/other.parquet"),
    "a file is listed twice": twice,
}

MANIFEST_PATH, TABLE_PATH = "manifests/{}.json", "tables/evaluations/{}.parquet"

TABLE: dict[str, Callable[[bytes], bytes]] = {
    "truncated": ANY_FILE["truncated"],
    "empty": ANY_FILE["empty"],
    "text": ANY_FILE["an object"],
    "a flipped bit": lambda data: data[:40] + bytes([data[40] ^ 1]) + data[41:],
}

DAMAGE = [(MANIFEST_PATH, MANIFEST_PATH, change) for change in MANIFEST.values()]
DAMAGE += [(TABLE_PATH, TABLE_PATH, change) for change in TABLE.values()]
DAMAGE += [(MANIFEST_PATH, TABLE_PATH, mistyped(rows=10**6))]
"""Which file is changed, which one is named, and how."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str], dict[str, RunRecord]]:
    """A root with damaged runs; the damaged file by run; all runs by id."""
    root = tmp_path_factory.mktemp("damage") / "root"
    campaign = SyntheticCampaign(root, steps=1_000)
    records = [campaign.record("adr", seed, "low") for seed in range(len(DAMAGE) + WHOLE)]
    campaign.seeds("adr", [1] * len(records), 1)
    damaged = {}
    for (changed, named, change), record in zip(DAMAGE, records, strict=False):
        path = root / changed.format(record.run_id)
        path.write_bytes(change(path.read_bytes()))
        damaged[record.run_id] = named.format(record.run_id)
    return root, damaged, {record.run_id: record for record in records}


@pytest.fixture
def root(runs: tuple[Path, dict[str, str], dict[str, RunRecord]], tmp_path: Path) -> Path:
    return Path(shutil.copytree(runs[0], tmp_path / "root"))


@pytest.fixture
def damaged(runs: tuple[Path, dict[str, str], dict[str, RunRecord]]) -> dict[str, str]:
    return runs[1]


def messages_of(action: Callable[[], Any]) -> tuple[Any, str]:
    with pytest.warns(DamagedFileWarning) as caught:
        result = action()
    return result, "\n".join(str(warning.message) for warning in caught)


def unnamed(damaged: dict[str, str], text: str) -> list[str]:
    return [path for path in damaged.values() if path not in text]


@pytest.mark.slow
def test_status_and_ranking_go_on(root: Path, runs: Any) -> None:
    _, damaged, records = runs
    found, text = messages_of(lambda: overview(root, time.time()))
    states = [run.state for runs in found.campaigns["first_look"].values() for run in runs]
    assert states.count("waiting") == len(MANIFEST)
    assert states.count("done") == len(records) - len(MANIFEST)
    assert not [path for path in unnamed(damaged, text) if path.startswith("manifests")]
    show_status(root, console=Console(file=io.StringIO()))
    frames, text = messages_of(lambda: load(root))
    assert frames.evaluations["run_id"].nunique() == WHOLE
    assert not unnamed(damaged, text)
    show_ranking(root, console=Console(file=io.StringIO()))


def test_what_is_damaged_is_verified_to_be_and_nothing_else(root: Path, damaged: dict[str, str]) -> None:
    found = verify_root(Store.open(root))
    assert {damage.path for damage in found.damage} == set(damaged.values())
    lost = {run for run, path in damaged.items() if path.startswith("manifests")}
    assert {Path(path).stem for path in found.unlisted} == lost


def test_a_campaign_does_damaged_runs_again(root: Path, runs: Any) -> None:
    _, damaged, records = runs
    committer = Committer.open(root)
    whole = set(records) - set(damaged)
    assert committer.done(list(records)) == whole
    for run_id in damaged:
        committer.start(records[run_id])
    results = Results.open(root)
    assert not results.problems
    assert {manifest.run.run_id for manifest in results.runs() if manifest.status == "done"} == whole


def test_files_are_merged_around_damage(root: Path, damaged: dict[str, str]) -> None:
    before = {path: (root / path).read_bytes() for path in damaged.values()}
    compaction, text = messages_of(lambda: compact(root))
    assert compaction.runs == WHOLE
    assert not unnamed(damaged, text)
    assert {path: (root / path).read_bytes() for path in damaged.values()} == before


def test_a_release_refuses_or_leaves_out_damage(root: Path, damaged: dict[str, str], tmp_path: Path) -> None:
    with pytest.raises(BaselineError, match=r"the root is damaged: .*manifests/.*and \d+ more.*--partial"):
        release(root, "refused", tmp_path)
    released = release(root, "partial", tmp_path, partial=True)
    assert verify(released).whole
    manifest = find_baseline(released).manifest
    assert manifest.holds["runs"] == WHOLE
    assert not unnamed(damaged, "\n".join(manifest.caveats))
    assert load(released).evaluations["run_id"].nunique() == WHOLE


ROOT_WIDE = ("root.json", "lease.json", "stop.json", "heartbeat.json", "compacting.json")


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("small") / "root"
    SyntheticCampaign(root).seeds("random", [1, 1], 1)
    return root


@pytest.mark.parametrize("name", [*ANY_FILE, "huge numbers", "text for numbers"])
def test_no_file_of_the_whole_root_blocks_it(small: Path, tmp_path: Path, name: str) -> None:
    root = Path(shutil.copytree(small, tmp_path / "root"))
    numbers = {"huge numbers": 10**30, "text for numbers": "x"}
    for path in ROOT_WIDE:
        fields = ("schema_version", "renewed_at", "at", "token", "holder", "runs", "unless_used", "replaced")
        typed = json.dumps({"format": "tma_ray results"} | dict.fromkeys(fields, numbers.get(name)))
        damage = ANY_FILE.get(name, lambda data, typed=typed: typed.encode())
        (root / path).write_bytes(damage((small / "root.json").read_bytes()))
    found, text = messages_of(lambda: Results.open(root))
    assert len(found.runs()) == 2
    assert "root.json is damaged" in text
    show_status(root, console=Console(file=io.StringIO()))
    with pytest.raises(NotRunningError, match=r"lease\.json is damaged"):
        ask_to_stop(Store.open(root))
    assert compact(root).runs == 2
    committer = Committer.open(root)
    assert len(committer.done([manifest.run.run_id for manifest in found.runs()])) == 2
    assert json.loads((root / "root.json").read_text())["schema_version"] == 1
    assert verify_root(Store.open(root)).damage == ()


def test_tables_about_runs_are_named_and_made_anew(small: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(small, tmp_path / "root"))
    damaged = [*root.glob("tables/attempts/*"), *root.glob("tables/cells/*")]
    for path in damaged:
        path.write_bytes(path.read_bytes()[:100])
    now = time.time()
    (_, frames, attempts), text = messages_of(lambda: (overview(root, now), load(root), load(root).attempts))
    assert attempts.empty
    assert frames.evaluations["run_id"].nunique() == 2
    assert not [path for path in damaged if path.name not in text]
    found = {damage.path for damage in verify_root(Store.open(root)).damage}
    assert found == {str(path.relative_to(root)) for path in damaged}
    names = ("environment", "challenge", "embodiment", "student", "teacher", "expert_knowledge")
    cell = {"experiment": "original", "run_id": "r", "seed": 0} | dict.fromkeys(names, "x")
    Committer.open(root).write_cells("first_look", [cell])
    assert len(Results.open(root).table(Table.CELLS)) == 1


def test_a_place_without_any_sign_of_a_root_is_refused(tmp_path: Path) -> None:
    (tmp_path / "root.json").write_text("{}")
    with pytest.raises(ResultsRootError, match=r"root\.json is damaged.*missing required field"):
        Results.open(tmp_path)
