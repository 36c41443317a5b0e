"""The report of a simulated flight: one HTML file that holds its pictures and needs nothing else."""

from sitl.report.data import ReportData
from sitl.report.plan import overview_png
from sitl.report.write import write_report

__all__ = ["ReportData", "overview_png", "write_report"]
