"""Output of commands: JSON has its declared keys, and tables fit 80 columns and name settings."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tma_ray.cli import main
from tma_ray.cli.json_output import KEYS, json_value
from tma_ray.results import RunStatus

ARGUMENTS: dict[str, list[str]] = {
    "run": [
        *("--student", "ppo:hidden_units=16x16", "--teacher", "random", "--steps", "300"),
        *("--test-set", "stump_tracks:every=25", "--results", "{root}-of-one-run"),
    ],
    "status": ["{root}"],
    "verify": ["{root}"],
    "ranking": ["{root}"],
    "claims": ["{root}"],
    "plan": ["parkour", "--tier", "smoke"],
    "list": [],
    "doctor": [],
    "baselines list": [],
}


@pytest.fixture
def printed(root: Path, capsys: pytest.CaptureFixture[str], known_speeds: None) -> Any:
    def run(command: str, *more: str) -> Any:
        arguments = [word.format(root=root) for word in ARGUMENTS[command]]
        assert main([*command.split(), *arguments, *more, "--json"]) == 0
        said = capsys.readouterr().out
        return json.loads(said, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))

    return run


@pytest.mark.parametrize("command", KEYS)
def test_every_command_prints_the_keys_that_are_declared(printed: Any, command: str) -> None:
    record = printed(command)
    assert list(record) == list(KEYS[command])
    assert any(record.values())


def test_status_and_ranking_name_settings(printed: Any) -> None:
    (campaign,) = printed("status")["campaigns"]
    cells = {cell["teacher"]: cell for cell in campaign["cells"]}
    assert set(cells) == {"random", "alp_gmm", "alp_gmm:fit_every=20"}
    assert {cell["student"] for cell in cells.values()} == {"ppo:hidden_units=16x16"}
    assert [run["state"] for cell in cells.values() for run in cell["runs"]] == [RunStatus.DONE] * 3
    rows = printed("ranking")["rows"]
    assert {row["teacher"] for row in rows} == set(cells)
    assert all(row["mastered_area_std"] is None for row in rows)  # of a single run


def test_everything_that_is_listed_is_described_and_one_kind_can_be_listed(printed: Any) -> None:
    kinds = printed("list")["kinds"]
    for kind, entries in kinds.items():
        for entry in entries:
            assert len(entry["description"]) > 5, f"{kind} {entry['name']}"
    assert {entry["name"] for entry in kinds["teachers"]} >= {"random", "alp_gmm"}
    assert printed("list", "teachers")["kinds"] == {"teachers": kinds["teachers"]}


def test_values_that_json_does_not_have() -> None:
    value = {
        "a": float("nan"),
        "b": [np.float32("inf"), np.int64(3)],
        "c": np.array([1.0, np.nan]),
        "d": Path("x"),
    }
    assert json_value(value) == {"a": None, "b": [None, 3], "c": [1.0, None], "d": "x"}


COMMANDS = [
    "status {root}",
    "status {root} --cells",
    "ranking {root}",
    "claims {root}",
    "claims {root} --details",
    "search {root}",
    "plan stump_tracks_challenges --tier smoke",
    "doctor",
    "list",
    "baselines list",
    pytest.param(
        "simulate --teachers random,alp_gmm:fit_every=20 --challenges original --seeds 1 --episodes 20",
        marks=pytest.mark.slow,
    ),
]


@pytest.mark.usefixtures("known_speeds")
@pytest.mark.parametrize("command", COMMANDS)
def test_tables_fit_80_columns(root, command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main([word.format(root=root) for word in command.split()]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines
    sentences = ("cost: ",)  # are never broken, so that they can be searched for
    too_long = [line for line in lines if len(line) > 80 and not line.startswith(sentences)]
    assert not too_long
    assert not any("…" in line for line in lines), "something is cut off"


def test_tables_name_settings(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ranking", str(root)]) == 0
    assert "fit_every=20" in capsys.readouterr().out
    assert main(["status", str(root), "--cells"]) == 0
    assert "alp_gmm:fit_every=20" in "".join(capsys.readouterr().out.split())
