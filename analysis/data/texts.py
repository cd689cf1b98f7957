"""Texts of frames as plain Python strings."""

from __future__ import annotations

import pandas as pd


def with_plain_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Returns `frame` with its texts and categories as Python strings, missing ones as they are.

    Names are few and short, and tables are grouped by a dozen of them again and again: pandas takes and
    groups Arrow's strings several times more slowly than objects, and merging unequal categories is fragile.
    """
    texts = frame.select_dtypes(["category", "str"]).columns
    return frame.astype(dict.fromkeys(texts, object))
