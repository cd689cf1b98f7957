"""Charts of learning curves: of all teachers, with significance stars, and of pairs of teachers."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from analysis.charts import base
from analysis.comparisons.pairwise import pairwise
from analysis.data.columns import COMPARED
from analysis.data.reference import BASELINE, is_baseline
from analysis.formatting import steps_text
from analysis.measures.evaluations import aggregate
from analysis.measures.pooling import PLUS, pooled
from analysis.names import label, order, short_labels, teacher_order, title
from analysis.teacher_styles import MUTED, TeacherStyle, teacher_style
from tma_ray.tasks import KnowledgeLevel

AXIS_TITLES = {"mastered_percent": base.MASTERED, "training_return": "Mean training return"}
"""Measures of `knowledge_panels`, with the titles of their axes."""

STAR_STEPS = 5_000_000  # steps between two stars of a line, as in the paper's figures of Parkour
MOST_PAIR_ROWS = 9  # with more rows of panels, `pairwise_curves` draws a matrix instead
FLATTENED = 0.5  # the ceiling is drawn only if a curve reaches this share of it
MOST_MARKED = 45  # lines with more points are drawn without markers

LEVEL = "expert_knowledge"

Line = tuple[str, str]  # teacher and level of expert knowledge

_DASHES: dict[str, str | tuple[int, tuple[int, ...]]] = {
    KnowledgeLevel.NONE.value: (0, (1, 1)),
    KnowledgeLevel.LOW.value: (0, (4, 2)),
    KnowledgeLevel.HIGH.value: "-",
}
_PALE = {KnowledgeLevel.NONE.value: 1.0, KnowledgeLevel.LOW.value: 0.6, KnowledgeLevel.HIGH.value: 0.0}


def learning_curves(
    table: pd.DataFrame,
    quantity: str,
    name: str = "curves",
    heading: str = "",
    caption: str = "",
    ceiling: float | None = None,
    against: str = base.STEPS,
) -> base.Chart:
    """Return a chart of each teacher's learning curve: mean ± one standard error over runs, against steps.

    Args:
        table: teacher, step, n, mean and standard_error, from `measures.evaluations.aggregate`.
        quantity: title of the vertical axis, with "%" for percentages.
        name: identifier of the chart.
        heading: title of the chart.
        caption: content and number of runs.
        ceiling: upper bound of all runs; None if unknown.
        against: title of the horizontal axis.
    """
    width = 1.4 if len(table) and table.groupby("teacher")["step"].size().max() > MOST_MARKED else 2.0
    rows = _rows_by_teacher(table)
    marks = [
        curve
        for teacher, text in short_labels(table["teacher"].astype(str), base.LONGEST_NAME).items()
        for curve in _curves(rows, teacher, teacher_style(teacher), text, width)
    ]
    y = base.PanelAxis(
        quantity, base.AxisKind.PERCENT if "%" in quantity else base.AxisKind.NUMBER, grid=True
    )
    panel = base.Panel(base.PanelAxis(against, base.AxisKind.STEPS), y, [*marks, *_ceiling(ceiling, marks)])
    return base.Chart(name, [[panel]], heading, caption)


def learning_curve(curves: pd.DataFrame, value: str, ylabel: str) -> base.Chart:
    """Return a chart of the learning curves of a comparison, from a table of its runs.

    Args:
        curves: teacher, run_id, step and `value`.
        value: column to draw.
        ylabel: title of the vertical axis.
    """
    return learning_curves(aggregate(curves, value), ylabel)


def _rows_by_teacher(table: pd.DataFrame) -> dict[str, base.Array]:
    """Return, by teacher, an array (rows, 4) of step, mean, standard error and n, without missing means."""
    columns = ("step", "mean", "standard_error", "n")
    rows = np.column_stack([table[column].to_numpy(np.float64) for column in columns])
    teachers, known = table["teacher"].to_numpy(object), ~np.isnan(rows[:, 1])
    return {teacher: rows[known & (teachers == teacher)] for teacher in dict.fromkeys(teachers)}


def _curves(
    rows: Mapping[str, base.Array], teacher: str, style: TeacherStyle, name: str, width: float, fill: str = ""
) -> Iterator[base.Curve]:
    """Yield a teacher's curve of mean ± standard error, if it has results."""
    chosen = rows.get(teacher, np.empty((0, 4)))
    if not len(chosen):
        return
    step, mean, error, n = chosen[np.argsort(chosen[:, 0])].T
    error = np.nan_to_num(error)
    words = [f"{m:.1f} ± {e:.1f}, n = {count:.0f}" for m, e, count in zip(mean, error, n, strict=True)]
    yield base.Curve(
        x=step,
        y=mean,
        low=mean - error,
        high=mean + error,
        n=n.astype(np.int64),
        look=style,
        fill=fill,
        name=name,
        teacher=teacher,
        width=width,
        texts=words,
        hover="{text}",
    )


def _ceiling(value: float | None, curves: Sequence[base.Curve]) -> Iterator[base.ReferenceLine]:
    """Yield a line at the ceiling (upper bound for all runs), unless it would flatten the curves."""
    highest = max((float(curve.high.max()) for curve in curves if curve.high is not None), default=0.0)
    if value is not None and highest >= FLATTENED * value:
        yield base.ReferenceLine(
            y=value, look=TeacherStyle(MUTED, "", (0, (1, 2))), name="mastered by any run", width=1.0
        )


@dataclass(frozen=True, eq=False)
class CurvePanel:
    """Data of a panel of `curves_with_stars`.

    Attributes:
        title: embodiment or challenge of the panel.
        curves: results of ``pooled(runs, [measure], by=["step"])``: teacher, expert_knowledge, step, n, and
            `measure` with the suffixes _mean and _std.
        tests: tests from `pairwise.pairwise` at each step against a reference teacher, or a reference level
            for each teacher; None for no stars.
        measure: measure to draw.
        name: name of the measure with its unit.
        ceiling: upper bound of all runs; None if unknown.
    """

    title: str
    curves: pd.DataFrame
    tests: pd.DataFrame | None = None
    measure: str = "mastered_percent"
    name: str = base.MASTERED
    ceiling: float | None = None

    def parts(self) -> list["CurvePanel"]:
        """Split the panel into several, each with Random and at most `TEACHERS_PER_PANEL` other teachers."""
        teachers = sorted(self.curves["teacher"].unique(), key=teacher_order) if len(self.curves) else []
        others = [teacher for teacher in teachers if not is_baseline(teacher)]
        if len(others) <= base.TEACHERS_PER_PANEL:
            return [self]
        random = [teacher for teacher in teachers if is_baseline(teacher)]
        groups = [
            others[start : start + base.TEACHERS_PER_PANEL]
            for start in range(0, len(others), base.TEACHERS_PER_PANEL)
        ]
        column = "first" if self.tests is not None and "teacher" not in self.tests else "teacher"
        return [
            replace(
                self,
                title=f"{self.title} ({number} of {len(groups)})",
                curves=self.curves[self.curves["teacher"].isin([*random, *group])],
                tests=None if self.tests is None else self.tests[self.tests[column].isin(group)],
            )
            for number, group in enumerate(groups, start=1)
        ]

    def table(self) -> pd.DataFrame:
        """Return a table of teacher, expert_knowledge, step, n, mean and standard_error, sorted by step."""
        keys = ["teacher", "expert_knowledge", "step"]
        return _table(self.curves, self.measure, keys, f"curves of panel {self.title!r}", empty=True)

    def stars(self, every: int) -> pd.DataFrame:
        """Return a table of line, step and difference for significant tests at multiples of `every` steps."""
        if self.tests is None or self.tests.empty:
            return pd.DataFrame(columns=["line", "step", "difference"])
        what = f"tests of panel {self.title!r}"
        base.check_table(self.tests, ["step", "first", "second", "holm", "difference"], what)
        due = self.tests[(self.tests["step"] > 0) & (self.tests["step"] % every == 0)]
        if due.empty:
            raise ValueError(
                f"{what}: none at a multiple of {every:,} steps; tested at "
                f"{', '.join(f'{step:,.0f}' for step in sorted(self.tests['step'].unique())[:5])}…"
            )
        rows = base.significant(due)
        columns = ("teacher", "first") if "teacher" in self.tests else ("first", "expert_knowledge")
        lines = list(zip(*(rows[column] for column in columns), strict=True))
        return rows[["step", "difference"]].assign(line=pd.Series(lines, index=rows.index, dtype=object))


def curves_with_stars(panels: Sequence[CurvePanel], every: int = STAR_STEPS, columns: int = 2) -> base.Chart:
    """Return a chart of learning curves (mean ± standard error), with stars at significant differences.

    Colours and markers denote teachers; dashes and marker fills denote levels of expert knowledge. Each line
    has a row of stars, full where it is significantly above the reference, hollow where it is below.

    Args:
        panels: panels row by row.
        every: steps between two stars.
        columns: panels side by side.

    Raises:
        ValueError: if all panels lack results, a line has two values at a step, or all tests lie between
            multiples of `every`.
    """
    if not panels:
        raise ValueError("no panels: expected at least one")
    parts = [part for panel in panels for part in panel.parts()]
    tables = [part.table() for part in parts]
    if all(table.empty for table in tables):
        raise ValueError("no panel has results: expected at least one with something to draw")
    stars = [part.stars(every) for part in parts]
    looks = _line_looks(tables)
    split = len(parts) > len(panels)
    starred = [line for line in looks if any(line in set(tests["line"]) for tests in stars)]
    steps = base.PanelAxis(
        base.STEPS, base.AxisKind.STEPS, 0.0, max(table["step"].max() for table in tables if len(table))
    )
    drawn = []
    for part, table, tests in zip(parts, tables, stars, strict=True):
        marks = [
            curve
            for (teacher, level), (style, name, fill) in looks.items()
            for curve in _curves(
                _rows_by_teacher(table[table[LEVEL] == level]), teacher, style, name, 1.7, fill
            )
        ]
        rows = []
        for line in starred:
            own = tests[tests["line"] == line]
            if len(own) or not split:
                above = list(own.loc[own["difference"] > 0, "step"])
                below = list(own.loc[own["difference"] < 0, "step"])
                style, _, fill = looks[line]
                rows.append(base.StarRow(style, fill, above, below, "-".join(line)))
        drawn.append(
            base.Panel(
                steps,
                base.PanelAxis(part.name, _kind(part.measure), grid=True),
                [*marks, *_ceiling(part.ceiling, marks)],
                part.title,
                stars=rows,
                empty_text="no results" if table.empty else "",
            )
        )
    lines = base.grid(drawn, 1 if split else columns)
    return base.Chart(
        "curves",
        lines,
        keys=list(_star_keys(parts, stars)),
        legend=base.Legend.BESIDE if split else base.Legend.TOP,
        size=(
            base.TWO_COLUMNS if len(lines[0]) > 1 else base.ONE_COLUMN,
            0.45 + len(lines) * (1.9 + 0.09 * (0 if split else len(starred))),
        ),
        letters=7.5,
    )


def _kind(measure: str) -> base.AxisKind:
    return base.AxisKind.PERCENT if measure.endswith("percent") else base.AxisKind.NUMBER


def _star_keys(panels: Sequence[CurvePanel], stars: Sequence[pd.DataFrame]) -> Iterator[base.LegendEntry]:
    """Yield the legend entries of filled and hollow stars, if there are any."""
    tests = [panel.tests for panel in panels if panel.tests is not None and len(panel.tests)]
    references = sorted({str(name) for table in tests for name in table["second"]})
    levels = any("teacher" in table for table in tests)
    names = " or ".join(title(LEVEL, name).lower() if levels else label(name) for name in references)
    differences = np.concatenate([rows["difference"].to_numpy(float) for rows in stars])
    for word, full, occurs in (("above", True, differences > 0), ("below", False, differences < 0)):
        if occurs.any():
            yield base.LegendEntry("*", f"{word} {names} (p < 0.05 after Holm)", full, 6)


def _line_looks(tables: Sequence[pd.DataFrame]) -> dict[Line, tuple[TeacherStyle, str, str]]:
    """Return the style, name and marker fill of each line, in the order of the legend.

    Several levels are distinguished by dashes, and by paler markers for less knowledge.
    """
    lines = {line for table in tables for line in zip(table["teacher"], table[LEVEL], strict=True)}
    names = short_labels(teacher for teacher, _ in lines)
    several = len({level for _, level in lines}) > 1
    looks = {}
    for teacher, level in sorted(lines, key=lambda line: (teacher_order(line[0]), order(LEVEL, line[1]))):
        style, name, pale = teacher_style(teacher), names[teacher], 0.0
        if several:
            level_title, pale = title(LEVEL, level), _PALE.get(level, 0.0)
            style = style._replace(dashes=_DASHES.get(level, "-"))
            name = f"{name}, {level_title.lower()}" if len(names) > 1 else level_title
        channels = [int(style.colour[start : start + 2], 16) for start in (1, 3, 5)]
        fill = "#" + "".join(f"{round(channel + (255 - channel) * pale):02x}" for channel in channels)
        looks[teacher, level] = style, name, fill
    return looks


def _table(
    curves: pd.DataFrame, measure: str, keys: Sequence[str], what: str, empty: bool = False
) -> pd.DataFrame:
    """Return a table of `keys`, n, mean and standard_error of a measure by step, without missing means."""
    mean, std = f"{measure}_mean", f"{measure}_std"
    columns = [*keys, "n", mean, std]
    if len(curves) or not empty:
        base.check_table(curves, columns, what)
    table = curves.reindex(columns=columns).rename(columns={mean: "mean", std: "std"})
    base.check_unique(table, keys, what)
    table = table[table["mean"].notna()].sort_values("step")
    return table.assign(standard_error=table["std"] / np.sqrt(table["n"].astype(float)))


def body_panels(
    runs: pd.DataFrame,
    measure: str = "mastered_percent",
    name: str = base.MASTERED,
    ceiling: float | None = None,
) -> list[CurvePanel]:
    """Return a panel per body, and one over all bodies if there are several, with tests against Random.

    Args:
        runs: rows from `pooling.pool_runs` of one comparison, with values from `run_measures.evaluations_at`.
        measure: measure to draw.
        name: name of the measure with its unit.
        ceiling: upper bound of all runs; None if unknown.

    Raises:
        ValueError: if the runs are not of one comparison.
    """
    _check_single(runs, COMPARED)

    def panel(heading: str, rows: pd.DataFrame, by: list[str]) -> CurvePanel:
        tests = pairwise(rows, measure, BASELINE, [*COMPARED, *by], detectable=False)
        return CurvePanel(heading, pooled(rows, [measure], by), tests, measure, name, ceiling)

    several = runs["embodiment"].nunique() > 1 or any(PLUS in pool for pool in runs["pool"])
    bodies = [
        panel(title("embodiment", body), runs[runs["embodiment"] == body], ["embodiment", "step"])
        for body in sorted(runs["embodiment"].unique())
    ]
    return [panel("All bodies", runs, ["step"]), *bodies] if several else bodies


def knowledge_panels(
    runs: pd.DataFrame,
    measures: Mapping[str, str] = AXIS_TITLES,
    reference: KnowledgeLevel | None = KnowledgeLevel.HIGH,
) -> list[CurvePanel]:
    """Return panels that compare levels of expert knowledge, one for each challenge and measure.

    Args:
        runs: rows from `pooling.pool_runs` with the `measures` at each step.
        measures: columns of `runs`, with the titles of their axes.
        reference: level that the others are tested against; None for no tests.

    Raises:
        ValueError: if the runs of a challenge differ in more than level and teacher.
    """
    within = [column for column in COMPARED if column != LEVEL]
    panels = []
    for challenge in sorted(runs["challenge"].unique(), key=lambda value: order("challenge", value)):
        rows = runs[runs["challenge"] == challenge]
        _check_single(rows, within)
        for measure, name in measures.items():
            tests, keys = None, [*within, "teacher", "step"]
            if reference is not None:
                tests = pairwise(rows, measure, reference.value, keys, LEVEL, detectable=False)
            curves = pooled(rows, [measure], ["step"])
            panels.append(CurvePanel(title("challenge", challenge), curves, tests, measure, name))
    return panels


def _check_single(runs: pd.DataFrame, columns: Sequence[str]) -> None:
    mixed = [column for column in columns if runs[column].nunique(dropna=False) > 1]
    if mixed:
        raise ValueError(
            f"runs of several comparisons: expected one {', '.join(mixed)}; select the rows of one"
        )


def pairwise_curves(
    curves: pd.DataFrame, tests: pd.DataFrame, measure: str = "mastered_percent", name: str = base.MASTERED
) -> base.Chart:
    """Return a chart with a panel per pair of teachers: mean ± standard error of both, against steps.

    Stars mark the steps of significant differences, in the colour of the better teacher. More than
    `MOST_PAIR_ROWS` + 1 teachers have a matrix of the differences at the last step instead.

    Args:
        curves: results of ``pooled(runs, [measure], by=["step"])`` for one comparison: teacher, step, n, and
            `measure` with the suffixes _mean and _std.
        tests: all pairs at every step, from `pairwise.pairwise` with step among `within`.
        measure: measure to draw.
        name: name of the measure with its unit.

    Raises:
        ValueError: if there are fewer than two teachers, or several values of a teacher at a step.
    """
    table = _table(curves, measure, ["teacher", "step"], "curves")
    legend = short_labels(table["teacher"].unique())
    teachers, names = list(legend), short_labels(legend, 15)
    if len(teachers) < 2:
        raise ValueError(f"curves of {len(teachers)} teachers: expected at least two, to compare them")
    size, tests = len(teachers) - 1, base.significant(tests)
    if size > MOST_PAIR_ROWS:
        return _difference_matrix(table, tests, teachers, name)
    error = table["standard_error"].fillna(0.0)
    low = 0.0 if measure.endswith("percent") else min(0.0, (table["mean"] - error).min())
    top = max((table["mean"] + error).max(), low + base.LEAST_PERCENT)
    axes = (
        base.PanelAxis(base.STEPS, base.AxisKind.STEPS, 0.0, table["step"].max()),
        base.PanelAxis(name, _kind(measure), low, top + 0.16 * (top - low)),
    )
    rows: list[list[base.Panel | None]] = [[None] * size for _ in range(size)]
    curve_rows = _rows_by_teacher(table)
    for column, row in itertools.combinations_with_replacement(range(size), 2):
        pair = teachers[column], teachers[row + 1]
        lines = [
            curve
            for name in pair
            for curve in _curves(curve_rows, name, teacher_style(name), legend[name], 1.2)
        ]
        stars = _pair_stars(tests, pair, top + 0.1 * (top - low))
        heading = names[pair[0]] if row == column else ""
        rows[row][column] = base.Panel(*axes, [*lines, *stars], heading, side=names[pair[1]])
    return base.Chart(
        "pairs",
        rows,
        keys=[base.LegendEntry("*", "differ at this step (p < 0.05)", colour=MUTED)],
        legend=base.Legend.TOP if size < 3 else base.Legend.CORNER,
        size=(
            base.ONE_COLUMN if size == 1 else base.TWO_COLUMNS,
            0.9 + (1.9 if size == 1 else min(1.5, (base.TWO_COLUMNS - 0.6) / size * 0.9) * size),
        ),
        letters=6.5,
    )


def _pair_stars(tests: pd.DataFrame, pair: tuple[str, str], height: float) -> Iterator[base.Scatter]:
    """Yield each teacher's stars, at the steps where it is significantly above the other."""
    for above, below in (pair, pair[::-1]):
        greater = (tests["first"] == above) & (tests["second"] == below) & (tests["difference"] > 0)
        less = (tests["first"] == below) & (tests["second"] == above) & (tests["difference"] < 0)
        steps = tests.loc[greater | less, "step"].to_numpy(float)
        if len(steps):
            style = teacher_style(above)._replace(marker="*")
            heights = np.full(len(steps), height)
            yield base.Scatter(x=steps, y=heights, look=style, size=7.0, svg_id=f"{above}-above-{below}")


def _difference_matrix(
    table: pd.DataFrame, tests: pd.DataFrame, teachers: Sequence[str], name: str
) -> base.Chart:
    """Return a heatmap of differences (row teacher minus column teacher), with dots on significant ones."""
    last = table["step"].max()
    means = table[table["step"] == last].set_index("teacher")["mean"].reindex(teachers).to_numpy(float)
    differences = means[:, None] - means[None, :]
    reach = max(float(np.nanmax(np.abs(differences))), 1.0)
    colours = base.ColourScale("RdBu", -reach, reach, f"Difference: {name[:1].lower()}{name[1:]}")
    at_end = tests[tests["step"] == last]
    ends = [np.array(list(map(teachers.index, at_end[side])), float) for side in ("first", "second")]
    centres = np.arange(len(teachers), dtype=np.float64)
    marks = [
        base.Heatmap(xs=centres, ys=centres, values=differences, colours=colours),
        base.Scatter(x=np.concatenate(ends), y=np.concatenate(ends[::-1]), size=3.5, svg_id="significant"),
    ]
    rows = base.PanelAxis(kind=base.AxisKind.TEACHERS, rows=short_labels(teachers, 18))
    heading = f"Row minus column after {steps_text(last)} steps; dots: p < 0.05 after Holm"
    side = min(base.TWO_COLUMNS + 0.6, 1.9 + 0.17 * len(teachers))
    return base.Chart(
        "differences",
        [[base.Panel(rows, rows, marks, heading)]],
        legend=base.Legend.NONE,
        size=(side + 0.6, side),
        letters=6.0,
    )
