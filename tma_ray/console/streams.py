"""Standard streams of a command."""

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Final

from tma_ray.support.texts import visible

_MODES: Final = {"stdin": "r", "stdout": "w", "stderr": "w"}  # in the order of their descriptors


class VisibleStream:
    """Stream that replaces control characters, wrapped around one to which rich writes directly."""

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream

    def write(self, text: str) -> int:
        """Write a text, and return its length."""
        self.rich_proxied_file.write(visible(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts in sequence."""
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
            if stream.fileno() == descriptor:  # the file got the lowest free descriptor
                os.set_inheritable(descriptor, True)
            setattr(sys, name, stream)
