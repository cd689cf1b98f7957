"""The terminal as every command writes to it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from tma_ray.commands.texts import visible


class _Terminal(Console):
    """A console whose texts hold nothing that a terminal would obey; its own colours and movements stay."""

    @property
    def file(self) -> IO[str]:
        """Stream below all that stand before it."""
        file = super().file
        while hasattr(file, "rich_proxied_file"):
            file = file.rich_proxied_file
        return file

    @file.setter
    def file(self, new: IO[str]) -> None:
        self._file = new

    def render_str(self, text: str, **settings: Any) -> Text:
        return super().render_str(visible(text), **settings)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        if isinstance(renderable, Text) and (shown := visible(renderable.plain)) != renderable.plain:
            renderable = renderable.copy()
            renderable.plain = shown
        return super().render(renderable, options)


def terminal(console: Console | None = None, **settings: Any) -> Console:
    """Returns `console`, or one that prints every text as it is, but for what a terminal would obey.

    Names of teachers, experiments and folders come from outside: rich would take ``[red]x`` for a colour
    and ``[/x]`` for an error, and pass escape sequences on. What is to have a colour is printed with a
    style, or as `rich.text.Text`.

    Args:
        console: given by a caller, who answers for its settings.
        settings: of `rich.console.Console`.
    """
    return console or _Terminal(markup=False, emoji=False, **settings)
