"""Interactive charts of pages, drawn by plotly in the reader's browser; `analysis.figures` are for paper."""

from analysis.pages.charts.chart import END, Chart, plotly_library
from analysis.pages.charts.curricula import probed_task_charts, training_task_charts
from analysis.pages.charts.curves import curve_chart
from analysis.pages.charts.mastery import mastery_charts
from analysis.pages.charts.overview import overview_chart
from analysis.pages.charts.profiles import profile_chart
from analysis.pages.charts.seeds import seeds_chart

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
