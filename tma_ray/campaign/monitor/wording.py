"""Durations and learners in words, as every view of a campaign tells them."""

from __future__ import annotations

from tma_ray.results import LearnerProgress


def duration(seconds: float) -> str:
    """Returns a time span in the two units that matter.

    Examples:
        >>> duration(42), duration(200), duration(7300), duration(200_000)
        ('42 s', '3 min 20 s', '2 h 1 min', '2 d 7 h')
    """
    units = [(86_400, "d"), (3_600, "h"), (60, "min"), (1, "s")]
    for (size, name), (smaller, smaller_name) in zip(units, [*units[1:], (0, "")], strict=True):
        if seconds >= size and smaller:
            return f"{int(seconds // size)} {name} {int(seconds % size // smaller)} {smaller_name}"
    return f"{int(seconds)} s"


def learner_line(learner: LearnerProgress) -> str:
    """Returns the learner of a cohort in one line."""
    kind = "memory" if learner.device == "cpu" else "GPU memory"
    return (
        f"learner on {learner.host}, {learner.device}: {learner.runs} of {learner.width} slots, "
        f"{learner.updates_per_second:,.0f} updates/s, busy {learner.busy:.0%}, "
        f"{learner.memory_gib:.1f} of {learner.memory_total_gib:.1f} GiB {kind}"
    )
