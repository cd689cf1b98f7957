"""The examples that helps end with run as they are written."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from commands import execute

from tma_ray import cli
from tma_ray.console import command_line

EXAMPLES = [
    example
    for _, app in command_line.commands(cli.app())
    for example in map(str.strip, str(app.help_epilogue or "").splitlines())
    if example.startswith("tma-ray") and ">" not in example
]

LONG = (
    *("--latex", "--watch", "--simulated", "tma-ray compare", "tma-ray wandb"),
    *("tma-ray report", "tma-ray leaderboard", "s3://"),
)
"""In examples that draw many pages, start a library in a process or need a store; the others are fast."""


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(each, marks=pytest.mark.slow if any(text in each for text in LONG) else ())
        for each in EXAMPLES
    ],
)
def test_the_example_runs(example: str, place: Path, request: pytest.FixtureRequest) -> None:
    shutil.copytree(place / "results", place / "colleague")
    if "s3://" in example:
        example = example.replace("s3://bucket", request.getfixturevalue("s3_root"))
    once = example.replace(" --watch", "")  # which goes on until Ctrl-C
    assert execute(shlex.split(once, comments=True)) == 0
