"""Processes that only write results do without pandas, and get it all the same if they ask."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import sys
from tma_ray.results import leave_pandas_out
leave_pandas_out()
import pyarrow as pa
table = pa.table({"step": pa.array([1, 2]), "name": pa.array(["a", None])})
assert "pandas" not in sys.modules
frame = table.to_pandas()
assert frame.step.tolist() == [1, 2]
import pandas as pd
assert pa.Table.from_pandas(pd.DataFrame({"step": [3]})).to_pylist() == [{"step": 3}]
leave_pandas_out()
assert pa.array(pd.Series([1.0, float("nan")])).null_count == 1
"""


def test_lists_become_columns_without_pandas() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)
