"""The web page of a dataset, which consists of static files that a browser opens from the disk."""

from .dataset_page import WIDTH_PX, write_report
from .pieces import ReportSummary

__all__ = ["WIDTH_PX", "ReportSummary", "write_report"]
