"""Execution of the commands in pages, at a small size."""

import importlib.util
import os
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib.metadata import metadata, version
from pathlib import Path

import click
from blocks import ROOT
from packaging.requirements import Requirement
from suite.locked import locked

from tma_ray import cli
from tma_ray.console.command_line import read

TINY = ["--steps", "300", "--evaluation-interval", "300", "--test-set", "one.csv"]

SMALL: dict[str, list[str]] = {
    **{name: ["--dry-run"] for name in ("campaign", "quickstart", "rerun")},
    "experiment": ["--dry-run", "--seeds", "1"],
    "run": TINY,
    "simulate": ["--episodes", "20", "--seeds", "1", "--challenges", "original", "--jobs", "1"],
    "render": ["--steps", "3"],
    "plan": ["--seeds", "1"],
    "figures": ["--only", "radar"],
    "play": ["--task", "0.5,3", "--output", "played.html"],
}
"""Options added to commands of `tma-ray`, overriding earlier ones."""

REDIRECTION = re.compile(r"\s\d?>\s*[^\s;&|)]+")


def simple_commands(line: str) -> Iterator[list[str]]:
    """Yield the words of every command in a line of shell code."""
    words = shlex.shlex(REDIRECTION.sub("", line), posix=True, punctuation_chars="();&|")
    words.whitespace_split = True
    command: list[str] = []
    for word in words:
        if set(word) <= set("();&|"):
            if command:
                yield command
            command = []
        else:
            command.append(word)
    if command:
        yield command


def execute(words: Sequence[str]) -> int:
    """Run a command in the working directory; return its exit code."""
    words = list(words)
    while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):
        _export([words.pop(0)])
    program, *arguments = words
    program = program.removeprefix(".venv/bin/")
    if program not in PROGRAMS:
        raise LookupError(f"nobody knows how to run {program!r}: teach PROGRAMS, or list it in EXEMPTIONS")
    return PROGRAMS[program](arguments)


def understood(words: Sequence[str]) -> None:
    """Check a command without running it: its program, its flags, its files."""
    words = [word for word in words if not re.fullmatch(r"[A-Z_]+=\S*", word)]
    program, *arguments = words
    if words[:3] == ["python", "-m", "tma_ray"]:
        program, arguments = "tma-ray", arguments[2:]
    if program == "tma-ray":
        if len(arguments) < 2:  # a command without arguments
            assert not arguments or arguments[0] in cli.app(), arguments
        else:
            read(cli.app(), arguments)
    elif program == "python":
        assert (ROOT / arguments[0]).is_file(), arguments[0]
    elif program == "make":
        PROGRAMS["make"](arguments)
    elif program == "ray":
        with suppress(click.MissingParameter):  # sentences may omit required arguments
            _ray(arguments)
    elif program == "pip":
        _pip(arguments)
    else:
        assert program in PROGRAMS


def _python(arguments: list[str]) -> int:
    if arguments[0] == "-m":
        if arguments[1] == "pip":
            return _pip(arguments[2:])
        return 0 if importlib.util.find_spec(arguments[1]) else 1
    script, *rest = arguments
    before, sys.argv = sys.argv, [script, *rest, "--seeds", "1", "--dry-run"]
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0


def _sbatch(arguments: list[str]) -> int:
    flags = [word for word in arguments if word.startswith("--") and "=" in word]
    script, *experiment = [word for word in arguments if word not in flags]
    known = set(re.findall(r"^#SBATCH (--[\w-]+)", Path(script).read_text(), re.MULTILINE))
    assert {flag.partition("=")[0] for flag in flags} <= {*known, "--gpus-per-node"}
    return _python(experiment)


def _pip(arguments: list[str]) -> int:
    """Check the packages of `pip install` against the tested versions."""
    command, *packages = [word for word in arguments if not word.startswith("-")]
    assert command == "install", command
    tested = locked() | {"tma_ray": version("tma_ray")}
    for package in packages:
        needed = Requirement(package)
        assert needed.specifier.contains(tested[needed.name]), package
        assert needed.extras <= set(metadata(needed.name).get_all("Provides-Extra") or ()), package
    return 0


def _run(*words: str) -> int:
    return subprocess.run(words, capture_output=True).returncode


def _ray(arguments: list[str]) -> int:
    """Parse a `ray` command without running it."""
    from ray.scripts.scripts import cli as commands

    command: click.Command = commands
    context = click.Context(command)
    while isinstance(command, click.Group) and arguments:
        name, *arguments = arguments
        found = command.get_command(context, name)
        assert found is not None, f"ray has no command {name!r}"
        command = found
    if arguments:
        command.make_context("ray", arguments)
    return 0


def _cd(arguments: list[str]) -> int:
    os.chdir(arguments[0])
    return 0


def _export(arguments: list[str]) -> int:
    for setting in arguments:
        name, _, value = setting.partition("=")
        os.environ[name] = value
    return 0


PROGRAMS: dict[str, Callable[[list[str]], int]] = {
    "tma-ray": lambda words: cli.main([*words, *SMALL.get(words[0], [])]),
    "nice": lambda words: execute(words[2:]),  # skips -n 19
    "python": _python,
    "sbatch": _sbatch,
    "make": lambda words: _run("make", "-C", str(ROOT), "-n", *words),
    "pip": _pip,
    "pytest": lambda words: _run(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words),
    "ray": _ray,
    "cp": lambda words: _run("cp", *words),
    "cd": _cd,
    "export": _export,
}
