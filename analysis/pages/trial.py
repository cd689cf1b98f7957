"""Page of a trial: verdicts and boundaries, curves, costs, and material for a paper."""

from pathlib import Path

import pandas as pd

from analysis.charts.base import Chart
from analysis.charts.curves import learning_curves
from analysis.charts.intervals import course_chart
from analysis.charts.page import on_page
from analysis.charts.paper.drawing import draw
from analysis.charts.paper.style import save
from analysis.data.frames import Frames
from analysis.formatting import interval_text, number
from analysis.names import label, own_first
from analysis.pages.page import page, write_page
from analysis.teacher_styles import shown_together
from analysis.trials import interim
from analysis.trials.design import Design
from tma_ray.console.exit_codes import installed_version
from tma_ray.support.texts import counted


def write_trial(
    folder: Path,
    design: Design,
    released: pd.DataFrame,
    looks: list[interim.InterimLook],
    frames: Frames,
    trial: Frames,
) -> Path:
    """Write the page of a trial, and next to it a table, a figure, a LaTeX row and a methods paragraph.

    Returns:
        The page, ``index.html``.
    """
    courses = {
        (measure, name): interim.course(design, released, looks, name, measure)
        for measure in design.axes
        for name in design.references
    }
    margins = {measure: design.margin_of(measure) for measure in design.axes}
    table = interim.verdict_table(design, looks)
    methods = interim.methods(design, looks[-1], _versions()) if looks else ""
    files: dict[str, bytes] = {}
    with shown_together([design.teacher, *design.references]), own_first([design.teacher]):
        charts = [
            course_chart({key: course}, design.teacher, {key[0]: margins[key[0]]}, f"course-{index}")
            for index, (key, course) in enumerate(courses.items())
        ]
        charts.append(_curves(design, frames, trial))
        text = page(
            "trial.html.j2",
            teacher=label(design.teacher),
            release=design.release,
            verdict=interim.sentence(design, looks[-1]) if looks else "No look is complete yet.",
            ended=interim.REASONS.get(looks[-1].ending, "") if looks else "",
            lines=[interim.look_line(look) for look in looks],
            plan=[line.strip() for line in interim.plan_lines(design, released)],
            rows=[
                row
                | {"interval": interval_text(row["low"], row["high"])}
                | {name: number(row[name]) for name in ("difference", "estimate")}
                for row in table.to_dict("records")
            ],
            charts=list(map(on_page, charts)),
            cost=_cost(design, trial),
            methods=methods,
            warnings=list(trial.notes) if looks else [],
            controls=None,
        )
        if looks:
            files["verdicts.csv"] = table.to_csv(index=False, float_format="%.3f").encode()
            files["row.tex"] = interim.latex_row(design, looks[-1]).encode()
            files["methods.txt"] = f"{methods}\n".encode()
            save(draw(course_chart(courses, design.teacher, margins)), folder / "trial")
    return write_page(folder, text, files)


def _versions() -> str:
    names = ("tma_ray", "numpy", "scipy")
    return f"Software: {', '.join(f'{name} {installed_version(name)}' for name in names)}."


def _curves(design: Design, frames: Frames, trial: Frames) -> Chart:
    """Return the learning curves of the new teacher and its references."""
    caption = f"Mean over {counted(len(design.cells), 'cell')} ± one standard error over runs"
    lines = interim.curves(design, frames, trial)
    return learning_curves(lines, "Mastered test tasks (%)", "curves", "Learning curves", caption)


def _cost(design: Design, trial: Frames) -> str:
    """Return a phrase with the numbers of runs and hours that the trial has taken."""
    runs = int((trial.cells.drop_duplicates("run_id")["status"] == "done").sum())
    hours = float(trial.run_hours.sum())
    text = f"{runs} of at most {design.looks[-1] * len(design.cells)} runs"
    return text + (f", {hours:.1f} hours of runs" if hours else "")
