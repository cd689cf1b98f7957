"""The report of a results root: one interactive page that needs nothing but itself."""

from analysis.pages.report.writing import write_report

__all__ = ["write_report"]
