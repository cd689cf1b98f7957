"""Make the small data set of the notebooks: a few runs of a finished campaign, as a release.

python experiments/stump_tracks_challenges.py --tier lite --teachers random,alp_gmm --expert-knowledge none \
    --results lite
python docs/making/make_notebook_data.py lite --output notebooks/data

Keeps the first seeds of every cell, and the policy of the run that masters most tasks.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import pandas as pd

from analysis.baselines import release
from analysis.data.frames import Frames
from analysis.data.loading import load
from analysis.measures.run_measures import run_measures
from tma_ray.results import Store, Table
from tma_ray.results.layout import POLICIES, TABLES, manifest_path
from tma_ray.results.parquet import decode, encode

NAME = "ppo-lite"

LEFT_BEHIND = ("checkpoints", "staging", "logs", "tmp", "lease.json", "heartbeat.json")


def main() -> None:
    """Write the data set to the folder `NAME`, which is a results root."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument("root", type=Path, help="results root of the campaign, in a folder")
    parser.add_argument("--output", type=Path, required=True, metavar="FOLDER", help=f"{NAME} is made in it")
    parser.add_argument("--seeds", type=int, default=2, metavar="N", help="of each cell (%(default)s)")
    parser.add_argument("--embodiment", default="classic_bipedal", metavar="NAME", help="%(default)s")
    options = parser.parse_args()
    frames = load(options.root)
    cells = frames.cells[frames.cells["status"] == "done"]
    cells = cells[(cells["seed"] < options.seeds) & (cells["embodiment"] == options.embodiment)]
    with tempfile.TemporaryDirectory() as folder:
        aside = Path(folder) / "root"
        shutil.copytree(options.root, aside, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
        _keep(Store.open(aside), frames, set(cells["run_id"]), best_run(frames, cells))
        print(release(aside, NAME, options.output, licence="MIT"))


def best_run(frames: Frames, cells: pd.DataFrame) -> str:
    """Return the run of `cells` with the most mastered tasks, ties broken by the mean return."""
    measured = run_measures(frames)
    measured = measured[measured["run_id"].isin(cells["run_id"])]
    return str(measured.sort_values(["mastered_percent", "evaluation_return"])["run_id"].iloc[-1])


def _keep(store: Store, frames: Frames, runs: set[str], best: str) -> None:
    """Delete all runs except `runs` from a root, and all policies except that of `best`."""
    for run_id in set(frames.cells["run_id"]) - runs:
        if store.exists(manifest_path(run_id)):
            store.delete(manifest_path(run_id))
    for path in store.files(POLICIES):
        if Path(path).parts[1] != best:
            store.delete(path)
    for path in store.files(f"{TABLES}/{Table.CELLS}"):
        rows = decode(Table.CELLS, store.read_bytes(path))
        kept = rows.filter([run_id in runs for run_id in rows["run_id"].to_pylist()])
        store.write_bytes(path, encode(Table.CELLS, kept))


if __name__ == "__main__":
    main()
