"""Contracts of the whole command line: descriptions, sentences, defaults, metavars, completion, start-up."""

from __future__ import annotations

import argparse
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tma_ray import cli
from tma_ray.benchmark import EXPERIMENTS
from tma_ray.campaign import Campaign, cells_of
from tma_ray.campaign.experiments import add_experiment_options
from tma_ray.campaign.options import add_options
from tma_ray.command_line import METAVARS, CommandParser

METAVAR = re.compile(rf"({'|'.join(METAVARS)})(,\.\.\.)?|NAME=VALUE")

ROOT = Path(__file__).parents[2]

PROGRAMS = ("analysis", "benchmarks", "docs", "examples", "experiments", "tests", "tma_ray")

MAIN = ("run", "campaign", "report", "compare", "ranking")


def parsers() -> list[CommandParser]:
    script, experiment = CommandParser(prog="script"), CommandParser(prog=EXPERIMENTS[0].name)
    add_options(script, Campaign("script", cells_of(("random", "riac"), ("ppo",)), (3, 5)))
    add_experiment_options(experiment)
    return [*cli._parser().commands(), script, experiment]


def options_of(parser: CommandParser) -> list[argparse.Action]:
    kinds = (argparse._SubParsersAction, argparse._HelpAction, argparse._VersionAction)
    return [action for action in parser._actions if not isinstance(action, kinds)]


def every_option() -> Iterator[tuple[str, CommandParser, argparse.Action]]:
    for parser in parsers():
        for action in options_of(parser):
            yield f"{parser.prog} {'/'.join(action.option_strings) or action.dest}", parser, action


def test_every_option_has_a_sentence_and_its_default() -> None:
    for name, parser, action in every_option():
        text = parser._get_formatter()._expand_help(action) if action.help else ""
        assert len(text.split()) > 1, f"{name} has no help"
        if action.option_strings and action.nargs != 0 and not action.required:
            assert text.count("(default: ") == 1, f"{name}: {text}"
            assert "default: None" not in text, name


def test_metavars_follow_the_rule() -> None:
    for name, _, action in every_option():
        if action.nargs == 0 or (action.choices and action.option_strings):
            assert action.metavar is None, name
        elif not action.choices:
            assert isinstance(action.metavar, str), name
            assert METAVAR.fullmatch(action.metavar), f"{name}: {action.metavar}"


def test_every_value_is_read_by_a_type_or_chosen() -> None:
    for name, _, action in every_option():
        assert action.nargs == 0 or action.type is not None or action.choices, name


def test_no_option_may_be_abbreviated_and_a_refusal_names_it(capsys: pytest.CaptureFixture[str]) -> None:
    for parser in parsers():
        options = {option for option in parser._option_string_actions if option.startswith("--")}
        for option in options:
            for short in {option[:end] for end in range(3, len(option))} - options:
                with pytest.raises(SystemExit):
                    parser.parse_args([short])
                assert option in capsys.readouterr().err, f"{parser.prog} {short}"


def test_every_program_of_the_project_has_such_a_parser() -> None:
    files = [file for folder in PROGRAMS for file in (ROOT / folder).rglob("*.py")]
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    assert sum("Parser(" in text for text in texts.values()) > 20
    assert [file for file, text in texts.items() if re.search(r"\bArgumentParser\(", text)] == []


def test_the_help_of_a_script_shows_what_its_campaign_has() -> None:
    script = CommandParser()
    add_options(script, Campaign("script", cells_of(("random", "riac"), ("ppo",)), (3, 5)))
    text = " ".join(script.format_help().split())
    for default in ("random,riac", "3,5", "20,000,000", "classic_bipedal", "stump_tracks"):
        assert f"(default: {default})" in text


def test_every_command_has_a_description_and_a_line_in_the_list() -> None:
    for parser in cli._parser().commands():
        assert parser.description, parser.prog
        assert parser.description.endswith("."), parser.prog
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                listed = {choice.dest: choice.help for choice in action._choices_actions}
                assert set(listed) == set(action.choices)
                assert all(listed.values())


def test_the_main_commands_have_examples_and_all_are_understood() -> None:
    commands = {parser.prog.removeprefix("tma-ray "): parser for parser in cli._parser().commands()}
    assert all(commands[name].examples for name in MAIN)
    for name in MAIN:
        assert "examples:\n  tma-ray" in commands[name].format_help()


def test_helps_fit_80_columns_but_for_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    for parser in parsers():
        text, _, _ = parser.format_help().partition("examples:")
        assert max(map(len, text.splitlines())) <= 80, parser.prog


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completions_know_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("campaign", "baselines", "environment-option", "verify"):
        assert word in script
    if shell == "bash":
        assert subprocess.run(["bash", "-n"], input=script, text=True).returncode == 0


def test_the_list_of_commands_has_a_line_for_each_that_begins_with_its_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = cli._parser().format_help().partition("COMMAND\n")[2].splitlines()
    first = [line.split() for line in lines if line.startswith("    ") and not line.startswith(" " * 6)]
    assert all(len(words) > 1 for words in first), "a name on a line of its own"
    assert {words[0] for words in first} >= {"run", "leaderboard", "tensorboard"}
