"""Examples of helps run as they are written, and campaigns of pages on a real Ray, with few episodes."""

import shlex
import shutil
from pathlib import Path

import pytest
from blocks import PAGES, blocks_of, lines_of
from commands import execute, simple_commands
from declared import changed

from tma_ray import cli
from tma_ray.cli import main
from tma_ray.console import command_line
from tma_ray.results import Results, RunStatus

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


SMALL = ["--seeds", "1", "--steps", "300", "--evaluation-interval", "300", "--memory-per-run", "0.5"]
"""What is added to each: the last of two equal flags counts."""


def campaigns_of(page: str) -> list[list[str]]:
    """Return the campaigns that a page starts, as they are run; those of a release have its size."""
    lines = (line for block in blocks_of(page) if block.language == "bash" for line in lines_of(block))
    commands = (words for line in lines for words in simple_commands(changed(page, line, run="")))
    campaigns = [words for words in commands if words[:2] == ["tma-ray", "campaign"]]
    return [words for words in campaigns if not {"--dry-run", "--like"}.intersection(words)]


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if campaigns_of(page)])
def test_the_campaigns_of_the_page_run(page: str, place: Path) -> None:
    import ray

    for block in blocks_of(page):
        if block.file:
            Path(block.file).write_text(block.text)
    for number, words in enumerate(campaigns_of(page)):
        if "--address" in words:  # the Ray of this machine stands for the cluster
            first = words.index("--address")
            del words[first : first + 2]
        tests = [] if "--environment" in words else ["--test-set", "one.csv"]
        root = f"campaign-{number}"
        try:
            assert main([*words[1:], *SMALL, *tests, "--results", root]) == 0, words
        finally:
            ray.shutdown()
        assert {run.status for run in Results.open(root).runs()} == {RunStatus.DONE}
