"""Terminal output of commands."""

from collections.abc import Iterable
from typing import IO, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from tma_ray.support.texts import visible


class _Terminal(Console):
    """Console that replaces all control characters in texts except its own."""

    @property
    def file(self) -> IO[str]:
        """Innermost stream, below its wrappers."""
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
    """Return `console`, or a new one that prints texts without markup and control characters.

    Names of teachers, experiments and folders may contain markup, such as ``[red]x`` or the erroneous
    ``[/x]``, and escape sequences.
    """
    return console or _Terminal(markup=False, emoji=False, **settings)


def print_line(text: str) -> None:
    """Print a text without rich's colours or line breaks."""
    terminal().print(text, highlight=False, soft_wrap=True)
