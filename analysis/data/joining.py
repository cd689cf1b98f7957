"""The results of several roots, joined as if one root held them."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from analysis.data.frames import GROUP, STATUSES, Frames, cell_warnings
from analysis.data.identity import experiments_apart, named_apart
from analysis.data.specs import SETTINGS
from analysis.data.texts import with_plain_texts
from tma_ray.results import Results

STATE = ["status", "error", "spec", "steps", "test_set", "physics_version", *SETTINGS]
"""Columns of cells that come from the run, not from the campaign that lists it."""


def joined(frames: Sequence[Frames]) -> Frames:
    """Returns the runs of several roots as those of one: named together, every run once.

    A name that stands for different things in different roots is split, as within a root. A run that several
    roots have is read where it got furthest, in the first of them if it is finished in several.

    Args:
        frames: of `load`, at least one.
    """
    first, *others = frames
    if not others:
        return first
    places = _places(frames)
    (cells,), split = named_apart([_cells(frames, places)])
    cells, apart = experiments_apart(with_plain_texts(cells))
    tables = {
        name: pd.concat(
            [_of(getattr(each, name), place, places) for place, each in enumerate(frames)], ignore_index=True
        )
        for name in ("evaluations", "measured")
    }
    test_tasks = pd.concat([each.test_tasks for each in frames], ignore_index=True)
    of_each = [text for each in frames for text in each.told]
    told = (*of_each, *cell_warnings(cells, tables["evaluations"]), *split, *apart)
    return Frames(
        cells=cells,
        **tables,
        test_tasks=test_tasks.drop_duplicates(["test_set", "task_index"]).reset_index(drop=True),
        results=first.results,
        told=tuple(dict.fromkeys(told)),
        elsewhere={run_id: _results(frames[place], run_id) for run_id, place in places.items() if place},
    )


def _places(frames: Sequence[Frames]) -> dict[str, int]:
    """Returns which of `frames` each run is read from."""
    ranks: dict[str, tuple[int, int]] = {}
    for place, each in enumerate(frames):
        for run_id, status in each.cells[["run_id", "status"]].itertuples(index=False, name=None):
            rank = STATUSES.index(status), place
            ranks[run_id] = min(rank, ranks.get(run_id, rank))
    return {run_id: place for run_id, (_, place) in ranks.items()}


def _results(frames: Frames, run_id: str) -> Results:
    return frames.elsewhere.get(run_id, frames.results)


def _cells(frames: Sequence[Frames], places: dict[str, int]) -> pd.DataFrame:
    """Returns the cells of all, each with the state of its run where that is read."""
    cells = pd.concat(
        [each.cells.assign(place=place) for place, each in enumerate(frames)], ignore_index=True
    )
    here = cells["place"] == cells["run_id"].map(places)
    state = cells[here].drop_duplicates("run_id").set_index("run_id")[STATE]
    away = ~here
    if away.any():
        cells[STATE] = cells[STATE].astype(object)  # whole numbers of any width fit then
        cells.loc[away, STATE] = state.loc[cells.loc[away, "run_id"]].to_numpy(object)
    cells = cells.drop(columns="place").infer_objects()
    return cells.drop_duplicates([*GROUP, "run_id"]).reset_index(drop=True)


def _of(table: pd.DataFrame, place: int, places: dict[str, int]) -> pd.DataFrame:
    """Returns the rows of runs that are read from `place`."""
    run_ids = table["run_id"].astype(object)
    return table[(run_ids.map(places) == place).to_numpy(bool)]
