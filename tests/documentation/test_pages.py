"""Every command and code block of the documentation is run; what is not says why in `declared`."""

from __future__ import annotations

import importlib
import shutil
import sys
import warnings
from fnmatch import fnmatch
from pathlib import Path
from types import ModuleType

import pytest
from blocks import PAGES, ROOT, Block, blocks_of, inline_commands, lines_of
from commands import TINY, execute, simple_commands, understood
from data_blocks import CHECKS
from declared import CHANGES, ENDINGS, EXEMPTIONS, changed, exempt, exit_code

from tma_ray.campaign import costs
from tma_ray.campaign.pace import Pace
from tma_ray.cli import main

LINKED = ("experiments", "docs", "cluster.yaml")
"""What of the repository the commands of pages name."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results root with two teachers' runs."""
    folder = tmp_path_factory.mktemp("documentation")
    (folder / "one.csv").write_text("stump_height,obstacle_spacing\n0,6\n1.5,3\n")
    small = [*TINY[:-1], str(folder / "one.csv"), "--probe-interval", "100", "--training-window", "100"]
    for teacher in ("random", "alp_gmm"):
        for seed in "01":
            run = ["run", "--teacher", teacher, "--student", "ppo", "--seed", seed, *small]
            assert main([*run, "--results", str(folder / "results")]) == 0
    return folder


@pytest.fixture
def place(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what pages assume: results, a test set, the examples, and the checkout's files."""
    shutil.copytree(root, tmp_path, dirs_exist_ok=True)
    for folder in (tmp_path, tmp_path / "examples"):
        shutil.copytree(ROOT / "examples", folder, dirs_exist_ok=True)
    for name in LINKED:
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "examples" / "one.csv").symlink_to(tmp_path / "one.csv")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    monkeypatch.setattr(costs, "measure", lambda spec, settings: Pace("any", 1e4, 1e4, 100))
    return tmp_path


@pytest.mark.parametrize("page", [page for page in PAGES if blocks_of(page)])
def test_every_block_of_the_page_runs(page: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In order: Python in one namespace, commands in one folder."""
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_REGION", "RAY_AUTH_MODE"):
        monkeypatch.setenv(name, "")  # pages may set these; what was before comes back
    (run,) = (path.stem for path in (place / "results" / "manifests").glob("ppo_alp_gmm-s0*"))
    module, known = ModuleType("page"), set(sys.modules)
    sys.modules["page"] = module  # dataclasses look for their module there
    try:
        for block in blocks_of(page):
            _run(block, module, place, run)
    finally:
        for name in set(sys.modules) - known:
            if name == "page" or str(getattr(sys.modules[name], "__file__", "")).startswith(str(place)):
                del sys.modules[name]


def _run(block: Block, module: ModuleType, place: Path, run: str) -> None:
    text = changed(block.page, block.text, run=run)
    if block.file:
        Path(block.file).write_text(text)
    if block.language == "python" and exempt(block.page, block.text):
        compile(text, block.place, "exec")
    elif block.language == "python" and block.file:
        vars(module).update(vars(importlib.import_module(Path(block.file).stem)))
    elif block.language == "python":
        exec(compile(text, block.place, "exec"), vars(module))
    elif block.language == "bash":
        for line in lines_of(block):
            _run_line(block, line, run)
    else:
        assert block.language in CHECKS, f"{block.place}: nobody knows how to check {block.language!r}"
        CHECKS[block.language](text, place)


def _run_line(block: Block, line: str, run: str) -> None:
    for words in simple_commands(changed(block.page, line.partition(" #")[0], run=run)):
        command = " ".join(words)
        if not exempt(block.page, command):
            code = execute(words)
            assert code == exit_code(block.page, command), f"{block.place}: {command} ended with {code}"


@pytest.mark.parametrize("page", [page for page in PAGES if inline_commands(page)])
def test_commands_within_sentences_are_understood(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    for command in inline_commands(page):
        for words in simple_commands(command):
            try:
                understood(words)
            except SystemExit as error:
                raise AssertionError(f"{page}: `{command}` is refused") from error


def test_what_is_declared_is_of_use() -> None:
    """A change, an exemption or an ending that nothing needs any more is to be taken away."""
    code = {page: "\n".join(block.text for block in blocks_of(page)) for page in PAGES}
    commands = [
        (page, " ".join(words))
        for page in PAGES
        for block in blocks_of(page)
        if block.language == "bash"
        for line in lines_of(block)
        for words in simple_commands(line.partition(" #")[0])
    ]
    starts = commands + [(page, block.text) for page in PAGES for block in blocks_of(page)]
    for change in CHANGES:
        assert any(change.found in text for page, text in code.items() if fnmatch(page, change.pages)), change
    for each in (*EXEMPTIONS, *ENDINGS):
        assert any(fnmatch(page, each.pages) and text.startswith(each.beginning) for page, text in starts), (
            each
        )
