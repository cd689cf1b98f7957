"""Lists of columns by which cells and runs are grouped, compared, pooled and named."""

from typing import Final

CELL_COLUMNS = ["environment", "challenge", "embodiment", "student", "expert_knowledge"]
"""Columns that identify a cell, except for its teacher."""

COMPARISON = ["engine", "experiment", *CELL_COLUMNS]
"""Columns that teachers of a report must have in common to be compared."""

GROUP = [*COMPARISON, "teacher"]
"""Columns that runs of a report must have in common to be averaged over seeds."""

FROM_SPEC = ["engine", "mastery_threshold", "settings", "identity"]
"""Columns of runs that come from the spec: settings is a short hash of all but the seed, identity the JSON of
`specs.identity`."""

FROM_RUN = ["status", "error", "spec", "steps", "test_set", "physics_version", *FROM_SPEC]
"""Columns of cells that come from the run, not from the campaign that lists it."""

NAMED = ["challenge", "environment", "embodiment", "student", "teacher", "test_set"]
"""Columns of cells that name a part of a run; challenges come before the environments they belong to."""

NAME_SCOPE = ["engine", "physics_version"]
"""Columns within which a name has a single meaning."""

RUN_CONDITIONS: Final = {
    "steps": "{:,.0f} steps",
    "physics_version": "physics version {:.0f}",
    "mastery_threshold": "mastered over {:g}",
    "test_set": "test set {}",
}
"""Columns that runs of one experiment must have in common, with the formats of their values in names."""

CONDITIONS = ["steps", "engine", "physics_version", "mastery_threshold", "variant"]
"""Columns of pools that results must have in common to be counted, drawn or aggregated together."""

TABLE_CONDITIONS = [*CONDITIONS[:-1], "test_set"]
"""Columns of pooled results; a table has one value of each. test_set is empty for shipped test sets."""

SETTINGS = ["steps", "test_sets", "engine", "physics_version", "mastery_threshold"]
"""Columns that runs of a challenge must have in common to be comparable."""

COMPARED = ["environment", "challenge", "pool", "expert_knowledge", *SETTINGS, "variant"]
"""Columns that teachers must have in common to be compared."""

POOLED = [*COMPARED, "teacher"]
"""Columns that runs must have in common to be pooled; experiments and campaigns do not matter."""

PARTS = ["embodiment", "student"]
"""Columns of the parts of a pool."""

CHALLENGE = ["environment", "challenge", "pool", "test_sets"]
"""Columns of a challenge in an aggregate over several."""

STRATA = [*CHALLENGE, *PARTS]
"""Columns of the strata of an aggregate over challenges."""

ACROSS = ["expert_knowledge", *CONDITIONS]
"""Columns that runs of several challenges must have in common to be aggregated."""

CHALLENGE_LEVEL = ["environment", "challenge", "expert_knowledge"]
"""Columns of a challenge at a level of expert knowledge."""

RANDOM_APART = ("experiment", "expert_knowledge")
"""Columns of a comparison that do not affect Random."""

RANDOM_ALIKE = [*(column for column in COMPARISON if column not in RANDOM_APART), *RUN_CONDITIONS]
"""Columns that Random must have in common with the teachers of a report that are tested against it."""

CONDITION_LABELS: Final = {
    "environment": "environment",
    "challenge": "challenge",
    "steps": "training steps",
    "pool": "bodies or students",
    "test_sets": "test tasks",
    "engine": "engine",
    "physics_version": "physics version",
    "mastery_threshold": "threshold of mastery",
}
"""Columns that results of two sources must have in common to be compared, and their names in sentences."""

FILTERS: Final = {
    "engine": "Engine",
    "experiment": "Experiment",
    "environment": "Environment",
    "challenge": "Challenge",
    "expert_knowledge": "Expert knowledge",
    "embodiment": "Body",
    "student": "Student",
}
"""Columns by which readers of a page choose comparisons, and their labels."""
