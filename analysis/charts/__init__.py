"""Interactive charts of pages, drawn by plotly in the reader's browser; `analysis.figures` are for paper."""

from analysis.charts.chart import END, Chart, plotly_library
from analysis.charts.curricula import taught_charts, teaching_charts
from analysis.charts.curves import curve_chart
from analysis.charts.mastery import mastery_charts
from analysis.charts.overview import overview_chart
from analysis.charts.seeds import seeds_chart

__all__ = [
    "END",
    "Chart",
    "curve_chart",
    "mastery_charts",
    "overview_chart",
    "plotly_library",
    "seeds_chart",
    "taught_charts",
    "teaching_charts",
]
