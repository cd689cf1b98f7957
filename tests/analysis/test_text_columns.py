"""Texts in frames, of whatever type this version of pandas and its options give them."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from synthetic_results import SMALL, SyntheticCampaign

from analysis.data.frames import with_plain_texts
from analysis.data.loading import load
from tma_ray.cli import main

TEXTS = ["alp_gmm", None, "random"]


@pytest.mark.parametrize("dtype", ["object", "string", "category", pd.StringDtype("pyarrow")], ids=str)
def test_texts_and_categories_become_objects(dtype: object) -> None:
    frame = pd.DataFrame({"teacher": pd.Series(TEXTS, dtype=dtype), "seed": [0, 1, 2]})
    plain = with_plain_texts(frame)
    assert (plain["teacher"].dtype, plain["seed"].dtype) == (object, frame["seed"].dtype)
    assert plain["teacher"].dropna().tolist() == ["alp_gmm", "random"]


@pytest.mark.filterwarnings("ignore:The 'future.infer_string' option is deprecated")
@pytest.mark.parametrize("inferred", [True, False])
def test_results_are_read_with_and_without_inferred_texts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], inferred: bool
) -> None:
    """Without them, pandas 3 reads texts as pandas 2 does."""
    campaign = SyntheticCampaign(tmp_path, **SMALL)
    for teacher in ("random", "alp_gmm"):
        for seed in range(3):
            campaign.run(teacher, seed)
    with pd.option_context("future.infer_string", inferred):
        frames = load(tmp_path)
        assert sorted(frames.cells["teacher"]) == 3 * ["alp_gmm"] + 3 * ["random"]
        assert frames.cells["teacher"].dtype == object
        assert main(["ranking", str(tmp_path)]) == 0
    assert "alp_gmm" in capsys.readouterr().out.lower().replace("-", "_")
