"""Make the baseline paper-2021 of the package from the paper's tables (tma_ray/benchmark/paper_results.csv).

python docs/making/make_paper_baseline.py --output analysis/baselines

Run it again whenever those tables or the schema change. A test compares the shipped Parquet file with them.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from analysis.baselines import BaselineFile, BaselineKind, BaselineManifest
from analysis.baselines.catalogue import BASELINE_FILE
from analysis.baselines.description import CARD_FILE, card, holdings
from analysis.data.reference import PAPER, PAPER_ENGINE, paper_frame
from analysis.tables.paper_tables import published_table_results, result_tables
from tma_ray.results import PUBLISHED_FILE, SCHEMA_VERSION, Store, write_published

MADE = (
    "Typed from the four tables of results on Stump Tracks and the one on Parkour in the paper's appendix. "
    "Every entry is mastered test tasks in per cent after 20 million steps: runs behind it, mean, standard "
    "deviation."
)

CITATION = (
    "C. Romac, R. Portelas, K. Hofmann, P.-Y. Oudeyer: TeachMyAgent: a Benchmark for Automatic Curriculum "
    "Learning in Deep RL. Proceedings of the 38th International Conference on Machine Learning (ICML), 2021."
)

CAVEATS = (
    "Worlds of Box2D: their numbers are set beside ours, and never pooled with them or tested against them.",
    "Entries that look like slips of the paper are kept as printed and say so in the column `doubt`.",
    "Only means and deviations were published: there are no runs to test or to resample.",
)

LICENCE = "Facts from the paper, which is to be cited for them."


def main() -> None:
    """Write the folder of the baseline."""
    parser = argparse.ArgumentParser(allow_abbrev=False, description=__doc__)
    parser.add_argument(
        "--output", type=Path, required=True, metavar="FOLDER", help="paper-2021 is made in it"
    )
    store = Store.open(parser.parse_args().output / PAPER)
    rows = paper_frame()
    write_published(store, rows.to_dict("records"))
    columns = {f"{name}s": rows[name].tolist() for name in ("environment", "challenge", "teacher")}
    columns |= {
        name: sorted({each for names in rows[name] for each in names}) for name in ("embodiments", "students")
    }
    columns |= {"expert_knowledge": rows["expert_knowledge"].tolist(), "steps": rows["steps"].tolist()}
    counts = {"entries": len(rows), "doubtful_entries": int((rows["doubt"] != "").sum())}
    manifest = BaselineManifest(
        name=PAPER,
        kind=BaselineKind.PUBLISHED,
        schema_version=SCHEMA_VERSION,
        engine=PAPER_ENGINE,
        physics_versions=(),
        licence=LICENCE,
        created=datetime.now(UTC).date().isoformat(),
        software=f"tma_ray {version('tma_ray')}",
        caveats=CAVEATS,
        holds=holdings(columns, counts),
    )
    text = card(manifest, MADE, result_tables(published_table_results()), CITATION)
    store.write_bytes(CARD_FILE, text.encode())
    files = tuple(BaselineFile.of(store, path) for path in (CARD_FILE, PUBLISHED_FILE))
    store.write_bytes(BASELINE_FILE, replace(manifest, files=files).to_bytes())
    Path(store.full_path("tmp")).rmdir()


if __name__ == "__main__":
    main()
