"""Marks of the pairs that differ: compact letter display, and lanes of brackets."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

Pair = tuple[str, str]


def compact_letter_display(names: Sequence[str], different: Iterable[Pair]) -> dict[str, list[int]]:
    """Returns the compact letter display: letters of each name, from 0; two share one exactly if alike.

    Alike are those that do not differ. Piepho's insert-and-absorb algorithm (Journal of Computational and
    Graphical Statistics 13, 2004) asks for no order among names, and so is exact for tests with unequal
    variances, which are not transitive. Letters are numbered by the first of `names` that has them.

    Args:
        names: what was compared.
        different: pairs that differ significantly.
    """
    groups = [frozenset(names)] if names else []
    for first, second in different:
        split = []
        for group in groups:
            if first in group and second in group:
                split += [group - {first}, group - {second}]
            else:
                split.append(group)
        groups = _absorbed(split)
    groups.sort(key=lambda group: [names.index(name) for name in names if name in group])
    return {name: [letter for letter, group in enumerate(groups) if name in group] for name in names}


def _absorbed(groups: Sequence[frozenset[str]]) -> list[frozenset[str]]:
    """Returns `groups` without those that lie within another."""
    distinct = list(dict.fromkeys(groups))
    return [group for group in distinct if not any(group < other for other in distinct)]


def lanes(spans: Collection[tuple[int, int]]) -> dict[tuple[int, int], int]:
    """Returns for each span of whole numbers a lane, from 0, so that spans in a lane only touch.

    Short spans come first, so that long brackets lie outside.
    """
    found: dict[tuple[int, int], int] = {}
    for low, high in sorted(spans, key=lambda span: (span[1] - span[0], span)):
        taken = {lane for (start, end), lane in found.items() if start < high and low < end}
        found[low, high] = min(set(range(len(spans))) - taken)
    return found
