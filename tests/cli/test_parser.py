"""Contracts of the whole command line: descriptions, sentences, defaults, metavars, completion, start-up."""

import re
import subprocess
from collections.abc import Iterator

import pytest
from cyclopts import App, Argument

from tma_ray import cli
from tma_ray.campaign import Campaign, cells_of
from tma_ray.campaign.script import script
from tma_ray.console.command_line import METAVARS, UsageError, arguments, commands, help_text, read

METAVAR = re.compile(rf"({'|'.join(METAVARS)})(,\.\.\.)?|NAME=VALUE")
MAIN = ("run", "campaign", "report", "compare", "ranking")


def own_script() -> App:
    return script(Campaign("script", cells_of(("random", "riac"), ("ppo",)), (3, 5)))


def every_app() -> Iterator[tuple[str, App]]:
    yield "script", own_script()
    for words, app in commands(cli.app()):
        if app.default_command:
            yield " ".join(words), app


def every_option() -> Iterator[tuple[str, App, Argument]]:
    for name, app in every_app():
        for argument in arguments(app, described=True):
            yield f"{name} {'/'.join(argument.names)}", app, argument


def is_option(argument: Argument) -> bool:
    return argument.name.startswith("-")


def test_every_option_has_a_sentence_and_its_default() -> None:
    helps = {name: " ".join(help_text(app).split()) for name, app in every_app()}
    for name, _, argument in every_option():
        about = " ".join(str(argument.parameter.help or "").split())
        assert len(about.split()) > 1, f"{name} has no help"
        if is_option(argument) and argument.hint is not bool and not argument.required:
            option = re.escape(sorted(argument.names, key=len)[-1])
            sentence = rf"{option} \S+ {re.escape(about)}( \(default: [^)]*\))?"
            text = re.search(sentence, helps[name.rpartition(" ")[0]])
            assert text, name
            assert text[0].count("(default: ") == 1, f"{name}: {text[0]}"
            assert "default: None" not in text[0], name


def test_metavars_follow_the_rule() -> None:
    for name, _, argument in every_option():
        metavar = argument.parameter.metavar
        if argument.hint is bool or argument.get_choices():
            assert not metavar, name
        else:
            assert isinstance(metavar, str), name
            assert METAVAR.fullmatch(metavar), f"{name}: {metavar}"
            assert is_option(argument) or argument.name == metavar, name


def test_every_value_is_read_by_a_parser_of_ours() -> None:
    """The library's own conversion would accept more: None for an empty choice, a plus before a number."""
    for name, _, argument in every_option():
        assert argument.hint is bool or hasattr(argument.parameter.converter, "parse"), name


def test_no_option_may_be_abbreviated_and_a_refusal_names_it() -> None:
    tried: set[str] = set()
    for _, app in every_app():
        options = {each for argument in arguments(app) for each in argument.names if each.startswith("--")}
        for option in options - tried:
            for short in {option[:-1]} - options:
                with pytest.raises(UsageError, match=f"unknown option {short}: did you mean .*{option}"):
                    read(app, [short])
        tried |= options
    assert len(tried) > 70


def test_of_an_option_given_twice_the_last_counts() -> None:
    options = read(own_script(), ["--steps", "5k", "--yes", "--steps", "5K", "--yes"]).keywords["options"]
    assert (options.steps, options.yes) == (5_000, True)
    with pytest.raises(UsageError, match="'0': expected a whole number"):
        read(own_script(), ["--steps", "5", "--steps", "0"])


def test_an_argument_may_be_called_like_its_own_name() -> None:
    assert read(cli.app(), ["status", "ROOT"]).args == ("ROOT",)
    assert read(cli.app(), ["release", "ROOT", "NAME", "--lean"]).args == ("ROOT", "NAME")
    assert read(cli.app(), ["report", "ROOT", "ROOT"]).args == ("ROOT", "ROOT")
    assert read(cli.app(), ["search", "--", "--root"]).args == ("--root",)


def test_the_help_of_a_script_shows_what_its_campaign_has() -> None:
    text = " ".join(help_text(own_script()).split())
    for default in ("random,riac", "3,5", "20,000,000", "classic_bipedal", "stump_tracks"):
        assert f"(default: {default})" in text


def test_every_command_has_a_description() -> None:
    for words, app in commands(cli.app()):
        assert all(paragraph.endswith(".") for paragraph in app.help.split("\n\n")), words


def test_the_main_commands_have_examples() -> None:
    root = cli.app()
    for name in MAIN:
        assert "examples:\n  tma-ray" in help_text(root, [name])


def test_helps_fit_80_columns() -> None:
    for words, app in (*commands(cli.app()), ((), own_script())):
        assert max(map(len, help_text(app).splitlines())) <= 80, words


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completions_know_commands_and_options(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", shell]) == 0
    text = capsys.readouterr().out
    for word in ("campaign", "baselines", "environment-option", "verify"):
        assert word in text
    if shell == "bash":
        options = text.split("--results)")[1:]
        assert options
        assert all("compgen -f" in each.partition(";;")[0] for each in options), "no paths are completed"
        assert subprocess.run(["bash", "-n"], input=text, text=True).returncode == 0


def test_the_list_of_commands_has_a_line_for_each_that_begins_with_its_name() -> None:
    lines = help_text(cli.app()).partition("commands:\n")[2].splitlines()
    first = [line.split() for line in lines if line.startswith("  ") and not line.startswith(" " * 4)]
    assert all(len(words) > 1 for words in first), "a name on a line of its own"
    assert {words[0] for words in first} >= {"run", "leaderboard", "tensorboard"}
