"""Scalars of runs in a project of Weights & Biases: what its library, offline, would send."""

import importlib
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from synthetic_results import SyntheticCampaign
from test_tensorboard import Growing, expected

from tma_ray.cli import main

pytestmark = pytest.mark.slow  # the library starts a process of its own for every run, which writes its file


@pytest.fixture(autouse=True)
def no_account(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("wandb", reason="pip install 'tma_ray[dev]' brings the library")
    for name in ("WANDB_API_KEY", "WANDB_MODE", "WANDB_PROJECT"):
        monkeypatch.delenv(name, raising=False)
    for name in ("WANDB_CONFIG_DIR", "WANDB_CACHE_DIR", "WANDB_DATA_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "library"))


def records(file: Path) -> Iterator[Any]:
    """Yield what the library wrote: LevelDB's log format after a header of seven bytes."""
    from wandb.proto.wandb_internal_pb2 import Record

    content, place, whole = file.read_bytes(), 7, b""
    while place + 7 <= len(content):
        if (left := 32_768 - place % 32_768) < 7:
            place += left
            continue
        length, kind = int.from_bytes(content[place + 4 : place + 6], "little"), content[place + 6]
        whole += content[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # a whole record, or the last part of one
            yield Record.FromString(whole)
            whole = b""


def runs(folder: Path) -> dict[str, dict[str, Any]]:
    """Return by run its group, tags, configuration, and steps and values by name."""
    found: dict[str, dict[str, Any]] = defaultdict(lambda: {"series": defaultdict(list)})
    for file in sorted(folder.glob("wandb/offline-run-*/*.wandb")):
        run_id = re.sub(r"^run-|\.wandb$", "", file.name)
        for record in records(file):
            if record.WhichOneof("record_type") == "run":
                config = {entry.key: json.loads(entry.value_json) for entry in record.run.config.update}
                facts = {"group": record.run.run_group, "tags": list(record.run.tags), "config": config}
                found[run_id] |= facts | {"project": record.run.project}
            elif record.WhichOneof("record_type") == "history":
                items = ((item.key or "/".join(item.nested_key), item) for item in record.history.item)
                row = {name: json.loads(item.value_json) for name, item in items}
                for name in set(row) - {"global_step", "_step", "_runtime", "_timestamp"}:
                    found[run_id]["series"][name].append((row["global_step"], row[name]))
    return dict(found)


def send(root: Path, folder: Path, *more: str) -> dict[str, dict[str, Any]]:
    command = ["wandb", str(root), "--offline", "--project", "curricula", "--folder", str(folder), *more]
    assert main(command) == 0
    importlib.import_module("wandb").teardown()  # waits for the library's own process, which writes the files
    return runs(folder)


def published(run: dict[str, Any]) -> dict[str, Any]:
    """Return the scalars of a run that TensorBoard would show, too."""
    others = ("published/", "charts/")
    return {name: rows for name, rows in run["series"].items() if not name.startswith(others)}


def test_each_point_is_sent_once(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    folder, run = tmp_path / "wandb", Growing(campaign)
    checkpoint = run.grow(10)
    for _ in range(2):
        (found,) = send(campaign.root, folder).values()
        assert published(found) == expected([10])
    run.add(20)
    run.writer.flush()  # and killed before it is published
    run.attempt(checkpoint)
    run.grow(20)
    (found,) = send(campaign.root, folder).values()
    assert published(found) == expected([10, 20])
    assert found["series"]["published/training"] == [(10, 1), (20, 2)]
    assert len(list(folder.glob("wandb/offline-run-*"))) == 2  # nothing new opens no run


def test_runs_are_found_by_what_openrlbenchmark_asks_for(tmp_path: Path) -> None:
    campaign = SyntheticCampaign(tmp_path / "root")
    run_ids = {campaign.run("alp_gmm", seed) for seed in (0, 1)}
    found = send(campaign.root, tmp_path / "wandb")
    assert set(found) == run_ids
    assert len({run["group"] for run in found.values()}) == 1
    assert {run["config"]["seed"] for run in found.values()} == {0, 1}
    for run in found.values():
        assert run["project"] == "curricula"
        assert run["config"]["env_id"].split("/")[0] == "stump_tracks"
        assert run["config"]["exp_name"].split("-")[1] == "alp_gmm"
        assert {"alp_gmm", "sac"} <= set(run["tags"])
        assert run["series"]["charts/episodic_return"] == run["series"]["training/mean_return"]


def test_another_project_gets_all_of_it(campaign: SyntheticCampaign, tmp_path: Path) -> None:
    folder, run = tmp_path / "wandb", Growing(campaign)
    run.grow(10)
    send(campaign.root, folder)
    (found,) = send(campaign.root, folder, "--project", "other").values()
    assert found["series"]["training/mean_return"] == [(10, 1.0), (10, 1.0)]


def test_what_cannot_be_done_is_refused(campaign, tmp_path, told, monkeypatch):
    folder = tmp_path / "wandb"
    assert "a results root" in told(2, "wandb", tmp_path / "nowhere", "--folder", folder)
    monkeypatch.setitem(sys.modules, "wandb", None)
    assert "pip install 'tma_ray[wandb]'" in told(2, "wandb", campaign.root, "--folder", folder)
    assert not folder.exists()
