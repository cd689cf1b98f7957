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


@pytest.mark.parametrize(
    "example",
    [pytest.param(each, marks=pytest.mark.slow if "--latex" in each else ()) for each in EXAMPLES],
)
def test_the_example_runs(example: str, place: Path) -> None:
    shutil.copytree(place / "results", place / "colleague")
    assert execute(shlex.split(example, comments=True)) == 0
