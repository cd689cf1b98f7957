"""Console of all commands."""

from collections.abc import Iterable
from typing import IO, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from tma_ray.support.texts import visible


class _Terminal(Console):
    """Console that replaces control characters in texts; its own colours and movements stay."""

    @property
    def file(self) -> IO[str]:
        """Innermost stream, below those that wrap it."""
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
    """Return `console`, or one that prints texts without markup and control characters.

    Names of teachers, experiments and folders come from outside: rich would read ``[red]x`` as a colour and
    ``[/x]`` as an error, and print escape sequences. Colours are styles, or `rich.text.Text`.
    """
    return console or _Terminal(markup=False, emoji=False, **settings)


def say(text: str) -> None:
    """Print a text as it is, without colours and line breaks of rich's."""
    terminal().print(text, highlight=False, soft_wrap=True)
