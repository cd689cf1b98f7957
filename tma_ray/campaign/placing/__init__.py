"""Places of runs: on any node that has room, or beside the learner of a cohort."""
