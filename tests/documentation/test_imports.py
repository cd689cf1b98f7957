"""What notebooks, pages and scripts import is there, whatever of them the fast tests do not run."""

import ast
import json
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec

import pytest
from blocks import PAGES, ROOT, blocks_of

OURS = ("tma_ray", "analysis")
SCRIPTS = ("examples/*.py", "experiments/*.py", "benchmarks/*.py", "docs/making/*.py")

PLACES = (
    *(path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob("notebooks/*.ipynb"))),
    *(path.relative_to(ROOT).as_posix() for pattern in SCRIPTS for path in sorted(ROOT.glob(pattern))),
    *(page for page in PAGES if any(block.language == "python" for block in blocks_of(page))),
)


def texts(place: str) -> Iterator[str]:
    """Yield the Python of a notebook's cells, of a page's blocks, or of a script."""
    if place.endswith(".ipynb"):
        for cell in json.loads((ROOT / place).read_text())["cells"]:
            if cell["cell_type"] == "code":
                yield "".join(line for line in cell["source"] if not line.startswith(("%", "!")))
    elif place.endswith(".md"):
        yield from (block.text for block in blocks_of(place) if block.language == "python")
    else:
        yield (ROOT / place).read_text()


def imports(text: str) -> Iterator[tuple[str, str]]:
    """Yield module and name of each thing that is imported; an empty name for a whole module."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((node.module, alias.name) for alias in node.names)


def lacking(module: str, name: str) -> str:
    """Return why an import fails, empty if it does not."""
    try:
        found = import_module(module)
        if name and not hasattr(found, name):
            import_module(f"{module}.{name}")
    except ImportError as error:
        return f"{module} {name}: {error}"
    return ""


@pytest.mark.parametrize("place", PLACES)
def test_everything_that_it_imports_is_there(place: str) -> None:
    """All imports of a notebook; of other files those of ours, the rest being beside them or optional."""
    found = {each for text in texts(place) for each in imports(text)}
    needed = sorted(
        (module, name)
        for module, name in found
        if module.partition(".")[0] in OURS or (place.endswith(".ipynb") and name != "__future__")
    )
    assert [why for each in needed if (why := lacking(*each))] == []


def test_an_import_that_moved_is_found() -> None:
    assert list(imports("from analysis.data import nowhere\nimport analysis.frames as f")) == [
        ("analysis.data", "nowhere"),
        ("analysis.frames", ""),
    ]
    assert "nowhere" in lacking("analysis.data", "nowhere")
    assert lacking("analysis.frames", "")
    assert not lacking("analysis.data.frames", "Frames")
    assert find_spec("analysis.frames") is None
