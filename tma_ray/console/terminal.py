"""Standard streams and terminal output of commands."""

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import TextIOWrapper
from pathlib import Path
from typing import IO, Any, Final

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from tma_ray.support.texts import visible


class _Terminal(Console):
    """Console that replaces control characters in strings, but prints its own."""

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
    """Return `console`, or a new one that ignores markup in strings and replaces control characters.

    Names of teachers, experiments and folders may contain markup, such as ``[red]x`` or the erroneous
    ``[/x]``, and escape sequences.
    """
    return console or _Terminal(markup=False, emoji=False, **settings)


def print_line(text: str) -> None:
    """Print a string without rich's highlighting and line wrapping."""
    terminal().print(text, highlight=False, soft_wrap=True)


def print_text(
    console: Console, text: str | Text, style: str | None = None, width: int | None = None
) -> None:
    """Print `text` on a console without markup and highlighting, wrapped at `width`."""
    console.print(text, style=style, highlight=False, markup=False, width=width)


_MODES: Final = {"stdin": "r", "stdout": "w", "stderr": "w"}  # in order of descriptors


class VisibleStream:
    """Wrapper around a stream that replaces control characters; rich writes to the stream itself."""

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write a string, and return its length."""
        self.rich_proxied_file.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write strings in sequence."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


@contextmanager
def standard_streams() -> Iterator[None]:
    """Context manager in which all standard streams exist and accept any text.

    Control characters are replaced as by `visible`, characters that cannot be encoded by "?".
    """
    _open_missing()
    with ExitStack() as stack:
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, TextIOWrapper) and stream.errors == "strict":
                stack.callback(stream.reconfigure, errors="strict")
                stream.reconfigure(errors="replace")
        stack.enter_context(redirect_stdout(VisibleStream(sys.stdout)))
        stack.enter_context(redirect_stderr(VisibleStream(sys.stderr)))
        yield


def _open_missing() -> None:
    """Open the null device for every standard stream that was closed at startup.

    Otherwise another file would take its descriptor, and receive the output of child processes.
    """
    for descriptor, (name, mode) in enumerate(_MODES.items()):
        if getattr(sys, name) is None:
            stream = Path(os.devnull).open(mode, encoding="utf-8")  # noqa: SIM115  # open until the end
            if stream.fileno() == descriptor:  # true if this was the lowest free descriptor
                os.set_inheritable(descriptor, True)
            setattr(sys, name, stream)
