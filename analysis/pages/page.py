"""Pages made of templates: self-contained, with one look."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from analysis.pages.charts import plotly_library
from tma_ray.commands.texts import visible


def page(template: str, **content: Any) -> str:
    """Returns the page that `template`, of the folder of templates, makes of `content`."""
    return _environment().get_template(template).render(**content)


@cache
def _environment() -> Environment:
    """Returns what compiles templates, each once."""
    environment = Environment(
        loader=PackageLoader("analysis.pages.page"),
        autoescape=True,
        finalize=lambda value: visible(value) if type(value) is str else value,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.globals["plotly_library"] = plotly_library
    return environment


def page_folder(root: str | Path, output: Path | None, name: str, what: str) -> Path:
    """Returns the folder that a page about `root` is written to: `output`, or `name` in `root`.

    Args:
        root: a folder, or an ``s3://`` or ``gs://`` address.
        output: what the user asked for, if anything.
        name: of the folder.
        what: is written, in words.

    Raises:
        ValueError: no `output`, and an object store or a root in which links would be written through.
    """
    if output is not None:
        return output
    if "://" in str(root):
        raise ValueError(f"{root} is not a local folder: say in which folder to write the {what}")
    folder = Path(root) / name
    for path in chain([folder], folder.rglob("*")):
        if path.is_symlink():
            raise ValueError(
                f"{path} is a symbolic link, which may lead out of the root: remove it, or say in which "
                f"folder to write the {what}"
            )
    return folder


def write_page(folder: Path, text: str, beside: Mapping[str, bytes]) -> Path:
    """Writes a page as ``index.html`` of `folder`, with files beside it by name; returns the page."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in beside.items():
        (folder / name).write_bytes(content)
    index = folder / "index.html"
    index.write_text(text, encoding="utf-8")
    return index


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
