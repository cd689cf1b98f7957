"""Interactive charts of pages, drawn by plotly in the reader's browser; `analysis.figures` are for paper."""

from analysis.pages.charts.chart import END, Chart, plotly_library
from analysis.pages.charts.curves import curve_chart, profile_chart
from analysis.pages.charts.seeds import overview_chart, seeds_chart
from analysis.pages.charts.tasks import mastery_charts, probed_task_charts, training_task_charts

__all__ = [
    "END",
    "Chart",
    "curve_chart",
    "mastery_charts",
    "overview_chart",
    "plotly_library",
    "probed_task_charts",
    "profile_chart",
    "seeds_chart",
    "training_task_charts",
]
