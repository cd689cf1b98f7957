"""Commands and code blocks of pages are run, or `declared` says why not; links and pictures are there."""

import importlib
import re
import sys
from fnmatch import fnmatch
from pathlib import Path
from types import ModuleType

import pytest
from blocks import FENCE, PAGES, ROOT, Block, blocks_of, inline_commands, lines_of
from commands import execute, simple_commands, understood
from data_blocks import CHECKS
from declared import CHANGES, ENDINGS, EXEMPTIONS, changed, exempt, exit_code

from tma_ray.console.command_line import UsageError

LONG = (
    *("README.md", "examples/README.md", "docs/add_embodiment.md", "docs/add_environment.md"),
    *("docs/add_student.md", "docs/add_teacher.md", "docs/baselines.md", "docs/commands.md"),
    *("docs/curriculum.md", "docs/experiments.md", "docs/get_started.md", "docs/object_stores.md"),
    *("docs/policies.md", "docs/releasing.md", "docs/simulated_students.md", "docs/training_code.md"),
)
"""Pages whose code trains, plays or reports again and again."""


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.slow if page in LONG else ()) for page in PAGES if blocks_of(page)],
)
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
    elif not exempt(block.page, block.text):
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
            except UsageError as error:
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
        used = [text.startswith(each.beginning) for page, text in starts if fnmatch(page, each.pages)]
        assert any(used), each


LINK = re.compile(r"\]\(((?!\w+:)[^)\s]+)\)")


def slug(heading: str) -> str:
    """Return the anchor of a heading."""
    text = re.sub(r"[`*]|\(http.*?\)", "", heading).lower()
    return re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", text).strip())


def anchors(page: str) -> set[str]:
    text = FENCE.sub("", (ROOT / page).read_text())
    return {slug(heading) for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    text = FENCE.sub("", (ROOT / page).read_text())
    for target in LINK.findall(text):
        file, _, anchor = target.partition("#")
        path = ((ROOT / page).parent / file).resolve() if file else ROOT / page
        assert path.exists(), f"{page}: {target}"
        assert not anchor or anchor in anchors(path.relative_to(ROOT).as_posix()), f"{page}: {target}"


FILE = re.compile(
    r"\b(?:analysis|benchmarks|docs|examples|experiments|notebooks|tests|tma_ray)/[\w/.-]*\.(?:py|csv|json|md|sh|toml)\b"
)


@pytest.mark.parametrize("page", PAGES)
def test_files_of_the_project_that_a_page_names_exist(page: str) -> None:
    missing = {path for path in FILE.findall((ROOT / page).read_text()) if not (ROOT / path).exists()}
    assert not missing, f"{page}: {missing}"


@pytest.mark.parametrize("page", PAGES)
def test_pictures_are_there_and_small(page: str) -> None:
    for picture in re.findall(r"!\[.+?\]\((.+?)\)", (ROOT / page).read_text()):
        size = ((ROOT / page).parent / picture).stat().st_size
        assert 1_000 < size < 700_000, f"{page}: {picture} has {size} bytes"
