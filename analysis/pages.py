"""Pages made of templates: self-contained, with one look."""

from __future__ import annotations

import base64
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from analysis.charts import plotly_library


def page(template: str, **content: Any) -> str:
    """Returns the page that `template`, of the folder of templates, makes of `content`."""
    environment = Environment(
        loader=PackageLoader("analysis"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    environment.globals["plotly_library"] = plotly_library
    return environment.get_template(template).render(**content)


def _data_uri(content: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
