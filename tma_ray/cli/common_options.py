"""Options and arguments shared by several commands."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tma_ray.console.command_line import choice, value, values
from tma_ray.console.types import folder, licence, named, new_file, root
from tma_ray.support.quantities import COUNT, SEED

Root = Annotated[str | Path, value(root, "ROOT")]
Roots = Annotated[str | Path, value(root, "ROOT", required=True)]
Folder = Annotated[Path, value(folder, "FOLDER")]
Output = Annotated[Path, value(folder, "FOLDER", alias="-o")]
NewFile = Annotated[Path, value(new_file, "FILE", alias="-o")]
Name = Annotated[str, value(named("a name"), "NAME")]
Baseline = Annotated[str | Path, value(named("a baseline"), "BASELINE")]
Policy = Annotated[str | Path, value(named("a policy"), "POLICY")]
Licence = Annotated[str, value(licence, "LICENCE")]
Count = Annotated[int, value(COUNT, "N")]
Seed = Annotated[int, value(SEED, "N")]

Baselines = Annotated[
    tuple[str, ...],
    values(
        named("a baseline"),
        "BASELINE",
        help="also the runs of this baseline: its name, folder or address; repeatable (default: none)",
    ),
]

HEADLINE = "mastered_area"
"""Default measure, as in `analysis.measures.tested`, which is slow to import."""

Measure = Annotated[
    str,
    choice(
        (HEADLINE, "last_three", "mastered_percent"),
        help="quantity that teachers are ranked by and tested on: test tasks mastered over training "
        "(area under the curve), at the last three evaluations on average, or at the last one",
    ),
]

RunResults = Annotated[str | Path, value(root, "ROOT", help="results root of the run")]

Json = Annotated[bool, Parameter(help="print JSON for scripts instead of text")]
