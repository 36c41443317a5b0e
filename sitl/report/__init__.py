"""The report of a simulated flight: one HTML file that holds its pictures and needs nothing else."""

from sitl.report.data import ReportData
from sitl.report.page import write_report
from sitl.report.plan import overview_png, plan_of

__all__ = ["ReportData", "overview_png", "plan_of", "write_report"]
