"""The examples that helps end with run as they are written."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from commands import execute

from tma_ray import cli

EXAMPLES = [
    example
    for parser in cli._parser().commands()
    for example in parser.examples
    if example.startswith("tma-ray") and ">" not in example
]


LONG = ("--latex", "--watch", "tma-ray compare", "tma-ray wandb", "tma-ray report", "tma-ray leaderboard")
"""In examples that draw many pages or start another library's process; fast ones try each command's page."""


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(each, marks=pytest.mark.slow if any(text in each for text in LONG) else ())
        for each in EXAMPLES
    ],
)
def test_the_example_runs(example: str, place: Path) -> None:
    shutil.copytree(place / "results", place / "colleague")
    once = example.replace(" --watch", "")  # which goes on until Ctrl-C
    assert execute(shlex.split(once, comments=True)) == 0
