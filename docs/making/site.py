"""Hooks of mkdocs: version of the site, pages outside of docs/, and links between them."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
DOCS = "docs/"

PAGES = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
    "benchmarks/measured/2026-11.md": "benchmarks/measured/2026-11.md",
    "examples/README.md": "examples/index.md",
    "notebooks/README.md": "notebooks/index.md",
}
"""Paths of pages outside of docs/, with their paths in the site."""

FILES = (
    *("cluster.yaml", "cluster-local.yaml", "deploy/*"),
    "analysis/pages/templates/sorting.js",
    *("benchmarks/measured/*.csv", "examples/*.py", "examples/*.toml", "notebooks/*.ipynb"),
)
"""Files that pages link to or run, with the same paths in the site."""

LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")


def on_config(config: Any) -> Any:
    """Add the version of the project to the footer of all pages.

    A site of several versions, made by mike, also has a menu of versions.
    """
    from tma_ray import __version__
    from tma_ray.benchmark import BENCHMARK_VERSION

    config.copyright = (
        f"tma_ray version {__version__}, benchmark version {BENCHMARK_VERSION}. {config.copyright}"
    )
    if "mike" in config.plugins:
        config.extra["version"] = {"provider": "mike"}
    return config


def on_files(files: Files, *, config: Any) -> Files:
    """Add the pages and files outside of docs/."""
    for source, place in PAGES.items():
        files.append(File.generated(config, place, abs_src_path=str(ROOT / source)))
    for pattern in FILES:
        for path in sorted(ROOT.glob(pattern)):
            name = path.relative_to(ROOT).as_posix()
            files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Convert links between files of the repository to links of the site."""
    place = page.file.src_uri
    sources = {there: here for here, there in PAGES.items()}
    folder = posixpath.dirname(sources.get(place, DOCS + place))

    def linked(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[1]))
        there = PAGES.get(target, target.removeprefix(DOCS))
        return posixpath.relpath(there, posixpath.dirname(place) or ".") + (match[2] or "")

    return LINK.sub(linked, markdown)
