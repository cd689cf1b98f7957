"""The terminal as every command writes to it."""

from __future__ import annotations

from typing import Any

from rich.console import Console


def terminal(console: Console | None = None, **settings: Any) -> Console:
    """Returns `console`, or one that prints every text as it is.

    Names of teachers, experiments and folders come from outside: rich would take ``[red]x`` for a colour
    and ``[/x]`` for an error. What is to have a colour is printed with a style, or as `rich.text.Text`.

    Args:
        console: given by a caller, who answers for its settings.
        settings: of `rich.console.Console`.
    """
    return console or Console(markup=False, emoji=False, **settings)
