"""Names in the terminal: as they are, whatever rich makes of them, but for what a terminal would obey."""

import json
import logging
import re
import sys
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet
from rich.live import Live
from rich.text import Text
from synthetic_results import SyntheticCampaign

import analysis
import tma_ray
from tma_ray.cli import main
from tma_ray.console.exit_codes import exit_code
from tma_ray.console.terminal import terminal
from tma_ray.results.lease import HeartbeatWriter

NAME = "[red]x[/x]:smile:"
"""What rich would colour, refuse and draw."""

EVIL = "\x1b]0;title\x07\x1b[2J\x1b[31m\u202eevil\x9b2J\u2066\rover"
"""A title of the window, cleared screens, red, text from right to left, a return to the line's beginning."""


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A root, got from somebody else, whose names and errors are meant for the terminal."""
    folder = tmp_path_factory.mktemp("hostile") / "root"
    names = {"experiment": f"x{EVIL}", "error": f"Traceback {EVIL}:\n{EVIL}", "host": f"h{EVIL}"}
    campaign = SyntheticCampaign(folder, **names)
    for number, teacher in enumerate(("random", f"t{EVIL}", NAME)):
        campaign.prefix = f"run-{number}-"
        campaign.seeds(teacher, [1, 1 + number % 2], 2, half=0.5)
    campaign.plain_run(f"t{EVIL}", 2, {1_000_000: [0.0, 0.0]}, status="failed", run_id="failed")
    HeartbeatWriter(campaign.committer.store, f"holder {EVIL}").beat({})
    (cells,) = (folder / "tables" / "cells").iterdir()
    table = parquet.read_table(cells)
    column = pa.array([f"c{EVIL}"] * len(table)).dictionary_encode()
    parquet.write_table(table.set_column(table.schema.get_field_index("campaign"), "campaign", column), cells)
    (folder / "tables" / f"{EVIL}.parquet").write_text("damaged")
    return folder


@pytest.mark.parametrize("command", ["ranking", "status --cells"])
def test_names_are_printed_as_they_are(hostile, command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    main([*command.split(), str(hostile)])
    assert NAME in capsys.readouterr().out


@pytest.mark.parametrize(
    "command",
    [
        *("status {root} --cells", "status {root} --json", "logs failed --results {root}", "ranking {root}"),
        *("ranking {root} --json", "leaderboard {root}", "compare {root} --baseline {root} -o {new}"),
        *("report {root} -o {new}", "tables {root}", "claims {root} --details", "search {root}"),
        *("verify {root}", "rerun {root} --failed --dry-run", "tensorboard {root} {new}"),
        "campaign --like {root} --teachers random --dry-run",
        "release {root} mine -o {new} --partial",
    ],
)
def test_nothing_that_a_terminal_would_obey_is_printed(hostile, command, tmp_path, capsys):
    words = [word.format(root=hostile, new=tmp_path / "new") for word in command.split()]
    main(words)
    shown = "".join(capsys.readouterr())
    pages = [path.read_text(encoding="utf-8") for path in tmp_path.rglob("index.html")]
    assert shown.strip()
    assert "Traceback (most" not in shown
    harmless = r"\n\t -~\u00a0-\u061b\u061d-\u200d\u2010-\u2027\u202f-\u2065\u206a-\U0010ffff"
    assert re.findall(f"[^{harmless}]", shown) == []
    for page in pages:
        assert not set(page) & set("\u202e\u2066\x9b")


def test_json_keeps_what_text_does_not_show(hostile: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", str(hostile), "--json"]) == 1
    campaigns = json.loads(capsys.readouterr().out)["campaigns"]
    assert [campaign["name"] for campaign in campaigns] == [f"c{EVIL}"]


def test_logs_and_warnings_obey_too_and_colours_of_our_own_stay(capsys: pytest.CaptureFixture[str]) -> None:
    def command() -> int:
        assert logging.lastResort is not None
        logging.lastResort.handle(logging.makeLogRecord({"msg": f"logged {EVIL}", "levelno": logging.ERROR}))
        terminal(force_terminal=True).print(Text(f"bold {EVIL}", style="bold"))
        with Live(Text(f"live {EVIL}"), console=terminal(force_terminal=True, color_system="standard")):
            sys.stdout.write(f"{EVIL} printed\n")
        raise ValueError(f"refused {EVIL}")

    assert exit_code("name", command) == 2
    out, err = capsys.readouterr()
    for word, shown in (("logged", err), ("refused", err), ("bold", out), ("live", out), ("printed", out)):
        assert word in shown
    assert out.startswith("\x1b[1mbold ")
    assert "\x1b[?25l" in out
    for mark in ("\x1b]", "\x1b[2J", "\u202e", "\x9b", "\u2066"):
        assert mark not in out + err, repr(mark)


def test_every_console_is_one_that_prints_names_as_they_are() -> None:
    folders = [Path(str(package.__file__)).parent for package in (analysis, tma_ray)]
    makers = [
        path.name
        for folder in folders
        for path in folder.rglob("*.py")
        if re.search(r"\bConsole\(|\(Console\)", path.read_text(encoding="utf-8"))
    ]
    assert makers == ["terminal.py"]
