"""Arrow's tables without pandas, which pyarrow would import to see whether a list is a series of it.

That import takes a process 40 MB and most of a second, and those that only write results need no data frame.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

import pyarrow as pa


class _Refusal(MetaPathFinder):
    """Lets no import find pandas."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002  # as the protocol has it
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        if fullname == "pandas":
            raise ModuleNotFoundError("pandas is left out", name=fullname)
        return None


def leave_pandas_out() -> None:
    """Lets pyarrow convert lists without pandas in this process, unless pandas is imported already.

    What asks for a data frame still gets one: pyarrow then imports pandas after all. Call it before other
    threads import anything.
    """
    if "pandas" in sys.modules:
        return
    refusal = _Refusal()
    sys.meta_path.insert(0, refusal)
    try:
        pa.array([0])  # looks for pandas once in a process
    finally:
        sys.meta_path.remove(refusal)
